"""Foxglove messages of scans: points of LiDARs, depth images of cameras, and where the sensors were."""

from __future__ import annotations

import base64
import heapq
import json
import math
from collections.abc import Iterable, Iterator
from typing import Final

import numpy as np
from numpy.typing import NDArray

from skyrange.core.arrays import Floats
from skyrange.core.time import NS_PER_S, Time
from skyrange.export.foxglove_messages import POSES_TOPIC, ROOT_FRAME, TimedMessage, time_json
from skyrange.export.foxglove_schemas import CAMERA_CALIBRATION, FRAME_TRANSFORMS, POINT_CLOUD, RAW_IMAGE
from skyrange.metrics.scans import Scan, read_received_scans
from skyrange.optics.mounted_sensors import MountedSensor
from skyrange.optics.sensor_models import DepthCameraModel
from skyrange.record.read.run import RunRecord

POINTS_TOPIC: Final = "/sensors/{}/points"
DEPTH_TOPIC: Final = "/sensors/{}/depth"
CALIBRATION_TOPIC: Final = "/sensors/{}/calibration"
UNKNOWN_KIND: Final = 255
"""`kind` of a point of a scan that no sensor made."""
_COLOURS: Final = np.array(
    [[160, 160, 160, 255], [110, 140, 110, 255], [150, 170, 210, 255], [255, 170, 0, 255]], dtype=np.uint8
)
"""Red, green, blue and alpha by what a pulse met: nothing, the ground, a building, an aircraft."""
_FORGED: Final = np.array([230, 30, 30, 255], dtype=np.uint8)
_POINT: Final = np.dtype(
    [
        ("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("kind", "u1"), ("forged", "u1"),
        ("red", "u1"), ("green", "u1"), ("blue", "u1"), ("alpha", "u1"),
    ]
)  # fmt: skip
_NUMERIC: Final = {"<f4": 7, "|u1": 1}
"""`foxglove.NumericType` of a type of numpy."""
_IDENTITY: Final = '{"position":{"x":0,"y":0,"z":0},"orientation":{"x":0,"y":0,"z":0,"w":1}}'
_OPTICAL: Final = (0.5, -0.5, 0.5, -0.5)
"""Rotation of a camera's frame (x to the right of the image, y down, z ahead) to forward, left, up."""
_MM: Final = 1000.0
HELD_NS: Final[Time] = NS_PER_S
"""How much later than it was received a scan may be recorded."""


def scan_messages(record: RunRecord, start_ns: int) -> Iterator[TimedMessage]:
    """The scans that companions received, in order of time; none of a run that keeps none.

    A LiDAR's are points in `enu`, from the true position of the sensor in the attitude that the scan has; a camera's
    are images of depths in mm, with their calibration. Both have a transform of the sensor's frame. Time is that of
    reception, and timestamps are those of the start of the scan.
    """
    if not record.keeps("scans") or not record.rows("scans"):
        return iter(())
    return _in_order(message for scan in read_received_scans(record) for message in _describe(scan, start_ns))


def _in_order(messages: Iterable[TimedMessage]) -> Iterator[TimedMessage]:
    """Messages that are nearly in order of time in that order."""
    waiting: list[tuple[Time, int, TimedMessage]] = []
    for number, message in enumerate(messages):
        heapq.heappush(waiting, (message.time_ns, number, message))
        while waiting and waiting[0][0] < message.time_ns - HELD_NS:
            yield heapq.heappop(waiting)[2]
    while waiting:
        yield heapq.heappop(waiting)[2]


def _describe(scan: Scan, start_ns: int) -> Iterator[TimedMessage]:
    at_ns = scan.received_ns or 0
    stamp, sensor = time_json(start_ns + scan.start_ns), scan.sensor
    name = f"{sensor.vehicle}/{sensor.id}"
    frame = json.dumps(name, ensure_ascii=False)
    yield TimedMessage(at_ns, POSES_TOPIC, FRAME_TRANSFORMS, f'{{"transforms":[{_transform(scan, stamp, frame)}]}}')
    if isinstance(sensor.model, DepthCameraModel):
        calibration = _calibration(sensor.model, stamp, frame)
        yield TimedMessage(at_ns, CALIBRATION_TOPIC.format(name), CAMERA_CALIBRATION, calibration)
        yield TimedMessage(at_ns, DEPTH_TOPIC.format(name), RAW_IMAGE, _image(scan, sensor.model, stamp, frame))
    else:
        yield TimedMessage(at_ns, POINTS_TOPIC.format(name), POINT_CLOUD, _cloud(scan, stamp))


def _cloud(scan: Scan, stamp: str) -> str:
    returns = scan.returns
    points = np.zeros(int(returns.sum()), dtype=_POINT)
    points["x"], points["y"], points["z"] = scan.points().T
    kind = np.full(len(points), UNKNOWN_KIND, dtype=np.uint8) if scan.kind is None else scan.kind[returns]
    points["kind"] = kind
    colours = _COLOURS[np.where(kind == UNKNOWN_KIND, 0, kind)]
    if scan.forged is not None:
        points["forged"] = scan.forged[returns]
        colours = np.where(scan.forged[returns][:, np.newaxis], _FORGED, colours)
    for place, channel in enumerate(("red", "green", "blue", "alpha")):
        points[channel] = colours[:, place]
    fields = ",".join(
        f'{{"name":"{name}","offset":{offset},"type":{_NUMERIC[kind.str]}}}'
        for name, (kind, offset, *_) in (_POINT.fields or {}).items()
    )
    return (
        f'{{"timestamp":{stamp},"frame_id":"{ROOT_FRAME}","pose":{_IDENTITY},"point_stride":{_POINT.itemsize},'
        f'"fields":[{fields}],"data":"{_encode(points)}"}}'
    )


def _image(scan: Scan, model: DepthCameraModel, stamp: str, frame: str) -> str:
    depth_mm = np.minimum(np.round(scan.steps * (scan.resolution_m * _MM)), 65_535).astype("<u2")
    width, height = model.pattern.width, model.pattern.height
    return (
        f'{{"timestamp":{stamp},"frame_id":{frame},"width":{width},"height":{height},"encoding":"16UC1",'
        f'"step":{2 * width},"data":"{_encode(depth_mm)}"}}'
    )


def _calibration(model: DepthCameraModel, stamp: str, frame: str) -> str:
    """That of a camera without distortion: the centre of the first pixel has the coordinates 0, 0, as in OpenCV."""
    grid = model.pattern
    across, down = grid.focal_px
    middle_x, middle_y = 0.5 * grid.width - 0.5, 0.5 * grid.height - 0.5
    return json.dumps(
        {
            "width": grid.width,
            "height": grid.height,
            "distortion_model": "plumb_bob",
            "D": [0.0] * 5,
            "K": [across, 0.0, middle_x, 0.0, down, middle_y, 0.0, 0.0, 1.0],
            "R": [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0],
            "P": [across, 0.0, middle_x, 0.0, 0.0, down, middle_y, 0.0, 0.0, 0.0, 1.0, 0.0],
        },
        separators=(",", ":"),
    ).replace("{", f'{{"timestamp":{stamp},"frame_id":{frame},', 1)


def _encode(values: NDArray[np.generic]) -> str:
    return base64.b64encode(values.tobytes()).decode()


def _transform(scan: Scan, stamp: str, frame: str) -> str:
    """Of the sensor's frame at the start of a scan: for a camera that of its image, else forward, left, up."""
    (x, y, z), (w, i, j, k) = place_sensor(scan)
    return (
        f'{{"timestamp":{stamp},"parent_frame_id":"{ROOT_FRAME}","child_frame_id":{frame},'
        f'"translation":{{"x":{x:.4f},"y":{y:.4f},"z":{z:.4f}}},'
        f'"rotation":{{"x":{i:.6f},"y":{j:.6f},"z":{k:.6f},"w":{w:.6f}}}}}'
    )


def place_sensor(scan: Scan) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """The true position of the sensor at the start of a scan in local coordinates, and the rotation of its frame by the
    attitude that the scan has: a quaternion, w first.
    """
    base = tuple(scan.estimate.tolist())
    place = scan.pose.position + _rotate(base, scan.pose.mount)
    turn = _multiply(base, _turn_mount(scan.sensor))
    if isinstance(scan.sensor.model, DepthCameraModel):
        turn = _multiply(turn, _OPTICAL)
    return tuple(place.tolist()), turn


def _turn_mount(sensor: MountedSensor) -> tuple[float, ...]:
    """As `optics.mounted_sensors.turn_mount`: yaw clockwise from above, then pitch up."""
    yaw, pitch = math.radians(-0.5 * sensor.yaw_deg), math.radians(-0.5 * sensor.pitch_deg)
    return _multiply((math.cos(yaw), 0.0, 0.0, math.sin(yaw)), (math.cos(pitch), 0.0, math.sin(pitch), 0.0))


def _multiply(a: tuple[float, ...], b: tuple[float, ...]) -> tuple[float, ...]:
    aw, ax, ay, az = a
    bw, bx, by, bz = b
    return (
        aw * bw - ax * bx - ay * by - az * bz,
        aw * bx + ax * bw + ay * bz - az * by,
        aw * by - ax * bz + ay * bw + az * bx,
        aw * bz + ax * by - ay * bx + az * bw,
    )


def _rotate(turn: tuple[float, ...], vector: Floats) -> Floats:
    axis = np.array(turn[1:])
    across = 2.0 * np.cross(axis, vector)
    turned: Floats = vector + turn[0] * across + np.cross(axis, across)
    return turned
