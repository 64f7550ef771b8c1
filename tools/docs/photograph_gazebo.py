"""Picture of Gazebo's window in the collision of `gazebo-speed` (tools.agreement): before, at and after the contact.

`python -m tools.docs.photograph_gazebo` rewrites `docs/images/gazebo-collision.png`. It flies the collision with
Gazebo's window open on a virtual display, and stops the range at each moment until the window has drawn it. It needs
Gazebo 11 with gzclient, Xvfb, and `import` and `convert` of ImageMagick.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import tempfile
import time
from pathlib import Path
from typing import Final

from skyrange.core.time import to_seconds
from skyrange.runtime.run import Run
from skyrange.vehicle.gazebo import world_file
from tools.agreement.gazebo_bench.collision import collision_scenario, measure

IMAGE: Final = Path(__file__).parents[2] / "docs" / "images" / "gazebo-collision.png"
MOMENTS_S: Final = (-0.2, 0.0075, 0.5)
"""Seconds from the contact."""
DISPLAY: Final = ":97"
SIZE: Final = "1000x760"
CROP: Final = "376x300+270+100"
"""Of the display: what the camera draws in the window that Gazebo 11 opens in its upper left corner."""
DRAWN_S: Final = 6.0
"""Wall seconds in which the window draws what has happened; software renders a few pictures a second."""
OPEN_BY_S: Final = 25.0
"""Simulated seconds by which the window must be open; while it opens, Gazebo must run to answer it."""
COLOURS: Final = 100
"""An open window has more colours than this."""
AWAY_M: Final = 3.2


def main() -> None:
    """Fly and photograph."""
    if missing := [name for name in ("Xvfb", "import", "convert") if shutil.which(name) is None]:
        raise SystemExit(f"install {', '.join(missing)}")
    hit = measure("gazebo")
    os.environ.update(DISPLAY=DISPLAY, LIBGL_ALWAYS_SOFTWARE="1")
    # the camera looks north at the place of the collision, and not at the fleet
    world_file.camera_place = lambda _: (0.0, -AWAY_M, hit["up_m"] - 0.2)  # type: ignore[assignment]
    world_file._PITCH, world_file._YAW = 0.0, 1.5708  # type: ignore[misc]
    with tempfile.TemporaryDirectory() as folder:
        command = ["Xvfb", DISPLAY, "-screen", "0", f"{SIZE}x24"]
        display = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        run = Run.start(collision_scenario("gazebo", window=True), Path(folder) / "run")
        try:
            time.sleep(1.0)
            picture = Path(folder) / "open.png"
            while take(picture) < COLOURS:
                if to_seconds(run.now) > OPEN_BY_S:
                    raise SystemExit("Gazebo's window does not open")
                run.advance(to_seconds(run.now) + 0.2)
                time.sleep(1.0)
            pictures = []
            for number, after_s in enumerate(MOMENTS_S):
                run.advance(hit["time_s"] + after_s)
                time.sleep(DRAWN_S)
                pictures.append(Path(folder) / f"{number}.png")
                take(pictures[-1])
            crop = ["-crop", CROP, "+repage", "-bordercolor", "white", "-border", "2x0"]
            made = ["convert", *map(str, pictures), *crop, "+append", "-colors", "128", f"PNG8:{IMAGE}"]
            subprocess.run(made, check=True)
        finally:
            run.finish()
            display.terminate()
            display.wait()


def take(picture: Path) -> int:
    """Write a picture of the display, and return the number of its colours."""
    subprocess.run(["import", "-window", "root", str(picture)], check=True)  # noqa: S607
    asked = ["convert", str(picture), "-format", "%k", "info:"]
    return int(subprocess.run(asked, check=True, capture_output=True).stdout)


if __name__ == "__main__":
    main()
