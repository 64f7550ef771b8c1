#!/bin/sh
# Makes the keys of a live range in /keys/range, and moves the secret key of each machine NAME given as an argument to
# /keys/NAME, which no other container has. Keys that are there stay.
set -eu
keys=${KEYS:-/keys}
for name in "$@"; do
    if [ ! -e "$keys/range/$name.key" ]; then
        skyrange keys "$keys/range" "$name" > /dev/null
        echo "made the key of $name"
    fi
    if [ -e "$keys/range/$name.key_secret" ]; then
        mv "$keys/range/$name.key_secret" "$keys/$name/$name.key_secret"
    fi
    if [ ! -s "$keys/$name/$name.key_secret" ]; then
        echo "$keys/$name has no key of $name: remove the volumes of keys, and start again" >&2
        exit 2
    fi
done
