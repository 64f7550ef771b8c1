"""Check of the viewer's modules: their types by the TypeScript compiler, their style by eslint.

`python -m tools.viewer_modules` installs both, once, prints what they find, and exits with 1 if they find something.
Modules and settings that have passed are not checked again until they change.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Final

from tools.node_packages import FOLDER, SETTINGS, digest_of, install_packages, run_node

ROOT: Final = Path(__file__).parents[1]
ASSETS: Final = ROOT / "src" / "skyrange" / "view" / "assets"
PASSED: Final = "passed"


def check_modules(assets: Path = ASSETS, folder: Path = FOLDER) -> bool:
    """Print what is wrong with the modules of a folder; whether nothing is. `folder` is that of the packages."""
    modules = sorted(assets.glob("*.js"))
    settings = sorted(path for path in SETTINGS.iterdir() if path.is_file())
    inputs, passed = digest_of([*modules, *settings]), folder / PASSED
    if passed.exists() and passed.read_text() == inputs:
        print(f"viewer modules: {len(modules)} as when they were checked")
        return True
    packages = install_packages(folder)
    project = folder / "tsconfig.json"
    project.write_text(json.dumps({"extends": str(SETTINGS / project.name), "include": [f"{assets}/*.js"]}))
    rules = f"--config={folder / 'eslint.config.js'}"
    right = [
        run_node(packages / "typescript" / "bin" / "tsc", "--project", str(project), cwd=assets),
        run_node(packages / "eslint" / "bin" / "eslint.js", "--max-warnings=0", rules, ".", cwd=assets),
    ] == [0, 0]
    if right:
        passed.write_text(inputs)
    print(f"viewer modules: {len(modules)} of right types and style" if right else "viewer modules: see above")
    return right


if __name__ == "__main__":
    sys.exit(0 if check_modules() else 1)
