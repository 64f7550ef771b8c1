# Images of skyrange. Targets: base, ardupilot, ns3, omnetpp, gazebo. How to build them, and what is given to each of them:
# docs/how-to/run-in-containers.md. No target downloads or compiles ArduPilot, OMNeT++, INET or Gazebo: they come from named
# build contexts, and the empty stages of the same names below stand for those that are not given.

# Debian 12 or another image with apt and Python 3.11 or newer, by tag and date. Without a registry: a file system that mmdebstrap made.
ARG BASE=docker.io/library/debian:bookworm-20250520-slim
# A built Gazebo runs only in the folder that it was configured for, its CMAKE_INSTALL_PREFIX.
ARG GAZEBO_PREFIX=/opt/gazebo

FROM scratch AS arducopter
FROM scratch AS omnetpp-tree
FROM scratch AS inet-tree
FROM scratch AS gazebo-apt
FROM scratch AS gazebo-tree


# --- skyrange in a virtual environment, with pip, which the images do not have ---------------------------------------
FROM ${BASE} AS builder
ENV PIP_DISABLE_PIP_VERSION_CHECK=1 \
    PIP_NO_CACHE_DIR=1
# Debian's stable release pins these packages by itself, and mends their security.
# hadolint ignore=DL3008
RUN set -eux; apt-get update; \
    apt-get install --yes --no-install-recommends python3 python3-pip python3-venv; \
    rm -rf /var/lib/apt/lists/*
WORKDIR /build
COPY requirements-image.txt requirements-build.txt ./
RUN set -eux; python3 -m venv --without-pip /opt/skyrange; \
    python3 -m pip --python /opt/skyrange/bin/python install --no-compile --only-binary :all: --require-hashes \
        -r requirements-image.txt; \
    python3 -m venv /build/tools; \
    /build/tools/bin/pip install --only-binary :all: --require-hashes -r requirements-build.txt
COPY pyproject.toml README.md LICENSE ./
COPY engines engines
COPY src src
# All files get one whole second as their time: layers round times, and Python's cache compares them.
ARG SOURCE_DATE_EPOCH=1767225600
RUN set -eux; /build/tools/bin/pip wheel --no-deps --no-build-isolation --wheel-dir /build/wheels .; \
    python3 -m pip --python /opt/skyrange/bin/python install --no-compile --no-deps --no-index /build/wheels/skyrange-*.whl; \
    find /opt/skyrange/lib/python3*/site-packages -type d -name tests -prune -exec rm -r {} +; \
    find /opt/skyrange -exec touch --no-dereference --date "@$SOURCE_DATE_EPOCH" {} +; \
    /opt/skyrange/bin/python -m compileall -q --invalidation-mode unchecked-hash /opt/skyrange/lib


# --- base: skyrange and its report -----------------------------------------------------------------------------------
FROM ${BASE} AS base
# hadolint ignore=DL3008
RUN set -eux; apt-get update; \
    apt-get install --yes --no-install-recommends python3; \
    rm -rf /var/lib/apt/lists/* /var/cache/apt/* /var/cache/debconf/*-old /var/log/apt /var/log/dpkg.log /var/log/alternatives.log; \
    groupadd --gid 10001 skyrange; \
    useradd --uid 10001 --gid 10001 --no-create-home --home-dir /tmp --shell /usr/sbin/nologin skyrange; \
    install --directory --owner 10001 --group 10001 --mode 0755 /work /work/runs /var/cache/skyrange; \
    install --directory --owner 10001 --group 10001 --mode 0700 /keys /keys/range /keys/blue /keys/green
COPY --from=builder /opt/skyrange /opt/skyrange
COPY --chmod=0755 containers/check_health.py /usr/local/bin/check-health
COPY --chmod=0755 containers/deal_keys.sh /usr/local/bin/deal-keys
ENV PATH=/opt/skyrange/bin:$PATH \
    HOME=/tmp \
    PYTHONDONTWRITEBYTECODE=1 \
    PYTHONUNBUFFERED=1 \
    XDG_CACHE_HOME=/var/cache \
    XDG_DATA_HOME=/opt/skyrange/share
USER 10001:10001
WORKDIR /work
# Compiles the numeric kernels into /var/cache/skyrange, and tries the image.
RUN set -eux; skyrange install kernels; \
    skyrange run squares --out /tmp/squares; \
    skyrange pair rid-spoofing --out /tmp/pair; \
    rm -r /tmp/squares /tmp/pair; \
    chmod -R a+rwX /var/cache/skyrange /work/runs
# Beside them only /tmp is written: a container may have a read-only root file system.
VOLUME ["/var/cache/skyrange", "/work/runs"]
ENTRYPOINT ["skyrange"]
CMD ["--help"]
HEALTHCHECK --interval=30s --timeout=5s --start-period=10s --retries=3 CMD ["check-health", "busy"]
LABEL org.opencontainers.image.title="skyrange" \
      org.opencontainers.image.description="A cyber range for small unmanned aircraft" \
      org.opencontainers.image.version="0.1.0" \
      org.opencontainers.image.licenses="Apache-2.0 AND MIT"


# --- ardupilot: given the context arducopter, a folder with the program arducopter -------------------------------------
FROM base AS ardupilot
COPY --from=arducopter --chmod=0755 arducopter /opt/arducopter/arducopter
ENV SKYRANGE_ARDUCOPTER=/opt/arducopter/arducopter
RUN "$SKYRANGE_ARDUCOPTER" --help > /dev/null
LABEL org.opencontainers.image.title="skyrange with ArduPilot"


# --- ns3: ns-3 from the package index, and skyrange's engine compiled against it ---------------------------------------
FROM builder AS ns3-builder
# hadolint ignore=DL3008
RUN set -eux; apt-get update; \
    apt-get install --yes --no-install-recommends g++; \
    rm -rf /var/lib/apt/lists/*
COPY requirements-engines.txt ./
RUN set -eux; python3 -m pip --python /opt/skyrange/bin/python install --no-compile --no-deps --only-binary :all: --require-hashes \
        -r requirements-engines.txt; \
    XDG_DATA_HOME=/opt/skyrange/share /opt/skyrange/bin/skyrange install ns3; \
    for packages in /opt/skyrange/lib/python3*/site-packages; do \
        mkdir --parents "/build/ns3/${packages#/opt/skyrange/}"; \
        mv "$packages/ns3" "/build/ns3/${packages#/opt/skyrange/}/"; \
    done; \
    rm -r /build/ns3/lib/python3*/site-packages/ns3/include

FROM base AS ns3
COPY --from=ns3-builder /build/ns3/lib /opt/skyrange/lib
COPY --from=ns3-builder /opt/skyrange/share /opt/skyrange/share
RUN set -eux; skyrange run rid-spoofing --set 'radio.engine="ns3"' --set duration_s=5 --out /tmp/ns3; \
    rm -r /tmp/ns3
LABEL org.opencontainers.image.title="skyrange with ns-3" \
      org.opencontainers.image.licenses="Apache-2.0 AND MIT AND GPL-2.0-only"


# --- omnetpp: given the contexts omnetpp-tree and inet-tree, built on the same BASE -----------------------------------
FROM builder AS omnetpp-builder
# hadolint ignore=DL3008
RUN set -eux; apt-get update; \
    apt-get install --yes --no-install-recommends g++; \
    rm -rf /var/lib/apt/lists/*
COPY --from=omnetpp-tree . /opt/omnetpp
COPY --from=inet-tree . /opt/inet
# Packages whose libraries the given OMNeT++ is linked with: libxml2 if it was configured WITH_LIBXML=yes.
ARG OMNETPP_PACKAGES=""
# hadolint ignore=DL3008,SC2086
RUN set -eux; apt-get update; \
    apt-get install --yes --no-install-recommends $OMNETPP_PACKAGES; \
    rm -rf /var/lib/apt/lists/*; \
    XDG_DATA_HOME=/opt/skyrange/share /opt/skyrange/bin/skyrange install omnetpp --omnetpp /opt/omnetpp --inet /opt/inet; \
    find /opt/inet -mindepth 1 -maxdepth 1 ! -name src ! -name LICENSE.md -exec rm -r {} +; \
    find /opt/inet/src ! -type d ! -name '*.ned' ! -name libINET.so -delete; \
    find /opt/inet -type d -empty -delete; \
    strip --strip-debug /opt/inet/src/libINET.so /opt/omnetpp/lib/*.so

FROM base AS omnetpp
USER 0:0
ARG OMNETPP_PACKAGES=""
# hadolint ignore=DL3008,SC2086
RUN set -eux; apt-get update; \
    apt-get install --yes --no-install-recommends $OMNETPP_PACKAGES; \
    rm -rf /var/lib/apt/lists/* /var/cache/apt/* /var/log/apt /var/log/dpkg.log
COPY --from=omnetpp-builder /opt/omnetpp/lib/*.so /opt/omnetpp/lib/
COPY --from=omnetpp-builder /opt/omnetpp/doc/License /opt/omnetpp/doc/License
COPY --from=omnetpp-builder /opt/inet /opt/inet
COPY --from=omnetpp-builder /opt/skyrange/share /opt/skyrange/share
USER 10001:10001
RUN set -eux; skyrange run rid-spoofing --set 'radio.engine="omnetpp"' --set duration_s=5 --out /tmp/omnetpp; \
    rm -r /tmp/omnetpp
LABEL org.opencontainers.image.title="skyrange with OMNeT++ and INET" \
      org.opencontainers.image.licenses="Apache-2.0 AND MIT AND LGPL-3.0-or-later AND LicenseRef-Academic-Public-License"


# --- gazebo: ardupilot, and Gazebo from packages (GAZEBO_PACKAGES) or built in a folder (the context gazebo-tree) ------
FROM ardupilot AS gazebo-packages
USER 0:0
# The context gazebo-apt has what is added to /etc/apt, such as sources.list.d/gazebo.sources and keyrings/gazebo.gpg.
COPY --from=gazebo-apt . /etc/apt/
# Gazebo itself, or the packages whose libraries a built Gazebo is linked with.
ARG GAZEBO_PACKAGES=""
# hadolint ignore=DL3008,SC2086
RUN set -eux; apt-get update; \
    apt-get install --yes --no-install-recommends $GAZEBO_PACKAGES; \
    rm -rf /var/lib/apt/lists/* /var/cache/apt/* /var/log/apt /var/log/dpkg.log
ARG GAZEBO_PREFIX
ENV PATH=${GAZEBO_PREFIX}/bin:$PATH \
    LD_LIBRARY_PATH=${GAZEBO_PREFIX}/lib
USER 10001:10001

FROM gazebo-packages AS gazebo-builder
# hadolint ignore=DL3002
USER 0:0
# Packages with Gazebo's headers, or with those that the headers of a built Gazebo include.
ARG GAZEBO_BUILD_PACKAGES=""
# hadolint ignore=DL3008,SC2086
RUN set -eux; apt-get update; \
    apt-get install --yes --no-install-recommends g++ pkg-config $GAZEBO_BUILD_PACKAGES; \
    rm -rf /var/lib/apt/lists/*
ARG GAZEBO_PREFIX
COPY --from=gazebo-tree . ${GAZEBO_PREFIX}/
RUN set -eux; XDG_DATA_HOME=/opt/skyrange/share skyrange install gazebo; \
    mkdir --parents "$GAZEBO_PREFIX"; \
    rm -rf "$GAZEBO_PREFIX/include" "$GAZEBO_PREFIX/lib/cmake" "$GAZEBO_PREFIX/lib/pkgconfig"

FROM gazebo-packages AS gazebo
ARG GAZEBO_PREFIX
COPY --from=gazebo-builder ${GAZEBO_PREFIX} ${GAZEBO_PREFIX}
COPY --from=gazebo-builder /opt/skyrange/share /opt/skyrange/share
RUN set -eux; skyrange run squares --set 'operators.*.vehicles.*.autopilot="gazebo"' --set duration_s=1 --out /tmp/gazebo; \
    rm -r /tmp/gazebo
LABEL org.opencontainers.image.title="skyrange with ArduPilot and Gazebo"
