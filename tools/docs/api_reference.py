"""Reference of the public modules, built by autodoc from signatures and docstrings: entries, links and markup.

A block `api MODULE` of a page lists exported names. `expand_blocks` turns each into a directive of autodoc. An object
that several modules export is described under its first name in the order of `FACADE`, and the others lead there.
"""

from __future__ import annotations

import importlib
import inspect
import re
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import is_dataclass
from enum import Enum
from functools import cache
from textwrap import indent
from typing import Any

from skyrange.core.lazy_exports import exports_of

FACADE = ("skyrange", "skyrange.scenario", "skyrange.plugin", "skyrange.analysis", "skyrange.env", "skyrange.testing")
"""The public modules."""
BLOCK = re.compile(r"^```api (\S+)\n(.*?)^```$", re.MULTILINE | re.DOTALL)

_SHARED_TEXT = """Several of the classes above have the members of these classes, which are not exported."""
_CODE = re.compile(r"`([^`]+)`")
_DOTTED = re.compile(r"[A-Za-z_]\w*(\.[A-Za-z_]\w*)*")
_STANDARD = {"Any", "Path"}
"""Names that signatures use for types of Python, and that a public module gives to others as well."""
_PROTOCOLS: set[type] = set()
_HIDDEN = {"model_config", "model_post_init", "faults_between"}
_HIDDEN |= {"own_params", "own_state", "declared_params", "declared_state", "params_model", "plugin"}
"""Members that only this project calls."""
_SHARING = 3
"""A private base of at least so many exported classes has an entry; members of others stand in each class."""


for _module in FACADE:
    importlib.import_module(_module)  # for `exports_of`

# ---------------------------------------------------------------- names


@cache
def _homes() -> dict[str, str]:
    """By each full name of an object, public ones and that in its own module, the one under which it is described."""
    exported = [(module, name, exports_of(module)[name]) for module in reversed(FACADE) for name in exports_of(module)]
    homes = {f"{home}.{original}": f"{module}.{name}" for module, name, (home, original) in exported}
    homes |= {f"{home}.{name}": f"{module}.{name}" for module, name, (home, _) in exported}  # once `_rename` was there
    return homes | {f"{module}.{name}": homes[f"{home}.{original}"] for module, name, (home, original) in exported}


@cache
def _publics() -> frozenset[str]:
    return frozenset(_homes().values())


@cache
def _described() -> dict[int, str]:
    """By the identity of an object, the public name under which it is described."""
    found: dict[int, str] = {}
    for public in (*_publics(), *_shared_bases()):
        value = _value(public)
        if id(value) not in found or public.endswith(f".{getattr(value, '__name__', '')}"):
            found[id(value)] = public
    return found


@cache
def _short_names() -> dict[str, set[str]]:
    found: dict[str, set[str]] = {}
    for home, public in _homes().items():
        for name in (home, public):
            found.setdefault(name.rpartition(".")[2], set()).add(public)
    return found


@cache
def _shared_bases() -> dict[str, str]:
    """By the full name of a private base that exported classes share, the public module that has most of these."""
    users: dict[str, Counter[str]] = {}
    for module in FACADE:
        exported = [_value(f"{module}.{name}") for name in exports_of(module)]
        bases = [base for value in exported if inspect.isclass(value) for base in value.__mro__[1:]]
        for base in bases:
            if base.__module__.startswith("skyrange."):
                users.setdefault(f"{base.__module__}.{base.__qualname__}", Counter())[module] += 1
    homes = {".".join(home) for module in FACADE for home in exports_of(module).values()}
    shared = {full: count for full, count in users.items() if full not in homes and count.total() >= _SHARING}
    return {full: count.most_common(1)[0][0] for full, count in shared.items()}


def _value(public: str) -> Any:
    module, _, name = public.rpartition(".")
    return getattr(importlib.import_module(module), name)


def find_public(target: str, module: str | None) -> str | None:
    """The public name of what a docstring or a signature of `module` names, with the attribute that follows it."""
    parts = target.lstrip("~.").split(".")
    for end in range(len(parts), 0, -1):
        head, tail = ".".join(parts[:end]), parts[end:]
        names = {_homes()[full] for full in (head, f"skyrange.{head}") if full in _homes()}
        if not names and head.startswith("skyrange.") and head in _shared_bases():
            names = {head}
        if not names and end == 1:
            names = {*_short_names().get(head, ())}
            here = {name for name in names if name == f"{module}.{head}"}
            names = here or (names if len(names) == 1 and head not in _STANDARD else set())
        if names:
            return ".".join([names.pop(), *tail])
    return None


# ---------------------------------------------------------------- entries


def expand_blocks(text: str) -> str:
    """A page with directives in place of its blocks `api`."""
    modules = {block[1] for block in BLOCK.finditer(text)}
    shared = [full for full, module in _shared_bases().items() if module in modules] if modules else []
    text = BLOCK.sub(lambda block: _entries(block[1], block[2].split()), text)
    if not shared:
        return text
    entries = "\n\n".join(_class_entry(_value(full), full) for full in shared)
    return f"{text}\n## Shared bases\n\n{_SHARED_TEXT}\n\n```{{eval-rst}}\n{entries}\n```\n"


def _entries(module: str, names: Sequence[str]) -> str:
    listed = " · ".join(f":py:obj:`{name} <{module}.{name}>`" for name in names)
    parts = [f".. py:currentmodule:: {module}", listed, *(_entry(module, name) for name in names)]
    return "```{eval-rst}\n" + "\n\n".join(parts) + "\n```"


def _entry(module: str, name: str) -> str:
    home, original = exports_of(module)[name]
    full = f"{module}.{name}"
    value, described = _value(full), _homes()[full]
    if inspect.isclass(value) and value.__module__.startswith("skyrange."):
        described = _described()[id(value)]
    if described != full:
        return f".. py:data:: {name}\n\n   The same as :py:obj:`{described}`."
    if inspect.isroutine(value) or callable(getattr(value, "__wrapped__", None)):
        return f".. autofunction:: {full}"
    if inspect.isclass(value) and value.__module__.startswith("skyrange."):
        _rename(value, name)
        return _class_entry(value, full)
    doc = f"The module ``{value.__name__}``." if inspect.ismodule(value) else "\n".join(_value_doc(home, original))
    shown = f"\n   :value: {value!r}" if isinstance(value, (int, tuple)) and len(repr(value)) < 80 else ""
    return f".. py:data:: {name}{shown}\n\n" + indent(doc, "   ")


def _class_entry(value: type, full: str) -> str:
    _forget_protocol(value)
    options = [
        ":members:",
        *([":undoc-members:"] if _has_fields(value) or value in _PROTOCOLS else []),
        f":inherited-members: {', '.join(_ends(value))}",
    ]
    options += [":show-inheritance:"] if [*_public_bases(value)] else []
    return "\n   ".join([f".. autoclass:: {full}", *options]) + "\n"


def _has_fields(value: type) -> bool:
    """Whether the attributes of a class are what it is made of."""
    fields = is_dataclass(value) or hasattr(value, "model_fields") or hasattr(value, "_fields")
    return fields or issubclass(value, Enum)


def _public_bases(value: type) -> Iterator[type]:
    """The nearest ancestors that have entries."""
    covered: set[type] = set()
    for base in value.__mro__[1:]:
        if base not in covered and id(base) in _described():
            covered.update(base.__mro__)
            yield base


def _ends(value: type) -> list[str]:
    """Names of the ancestors whose members are not repeated: public ones, and those of other packages."""
    return [
        base.__name__
        for base in value.__mro__[1:]
        if id(base) in _described() or not base.__module__.startswith("skyrange.")
    ]


def _attribute_docs(module: str) -> Any:
    from sphinx.pycode import ModuleAnalyzer

    analyzer = ModuleAnalyzer.for_module(module)
    analyzer.analyze()
    return analyzer


def _value_doc(home: str, original: str) -> list[str]:
    """The string below an assignment, as markup."""
    return to_rst(_attribute_docs(home).attr_docs.get(("", original), []), home)


def _rename(value: type, name: str) -> None:
    """Give a class its public name, under which autodoc looks for the strings below its attributes."""
    old = value.__qualname__
    if old == name:
        return
    analyzer = _attribute_docs(value.__module__)
    for table in (analyzer.attr_docs, analyzer.annotations):
        table.update({(name, key): text for (scope, key), text in [*table.items()] if scope == old})
    analyzer.tagorder.update(
        {name + at[len(old) :]: n for at, n in [*analyzer.tagorder.items()] if at.startswith(f"{old}.")}
    )
    value.__name__ = value.__qualname__ = name


def _forget_protocol(value: type) -> None:
    """Have autodoc ask for subclasses of a protocol, which only classes allow."""
    for base in value.__mro__:
        if vars(base).get("_is_protocol") and base.__module__.startswith("skyrange."):
            _PROTOCOLS.add(base)
            base._is_protocol = False  # type: ignore[attr-defined]


# ---------------------------------------------------------------- markup


def to_rst(lines: Sequence[str], module: str | None) -> list[str]:
    """Lines of a docstring, which are Markdown, as reStructuredText: code and links to what is public."""
    paragraphs = "\n".join(lines).split("\n\n")
    return "\n\n".join(part if part.lstrip().startswith(">>>") else _inline(part, module) for part in paragraphs).split(
        "\n"
    )


def _inline(text: str, module: str | None) -> str:
    parts = _CODE.split(text)
    made = []
    for at, part in enumerate(parts):
        if at % 2 == 0:
            made.append(re.sub(r"(?<!^)([*|]|_(?!\w))", r"\\\1", part.replace("\\", "\\\\")))
            continue
        code = " ".join(part.split())
        public = find_public(code, module) if _DOTTED.fullmatch(code) else None
        before = "\\ " if parts[at - 1][-1:].isalnum() else ""
        after = "\\ " if parts[at + 1][:1].isalnum() else ""
        made.append(before + (f":py:obj:`{code} <{public}>`" if public else f"``{code}``") + after)
    return "".join(made)


def _on_docstring(app: Any, what: str, name: str, value: Any, options: Any, lines: list[str]) -> None:
    module = next((one for one in sorted(FACADE, key=len, reverse=True) if name.startswith(f"{one}.")), None)
    lines[:] = to_rst(lines, module)
    if what == "class" and value.__module__.startswith("skyrange.scenario.model") and hasattr(value, "model_fields"):
        lines += ["", "Its fields are the keys of a scenario file.", ""]


def _on_signature(app: Any, what: str, name: str, value: Any, *others: Any) -> Any:
    """No signature where the attributes say the same, or where nobody calls the class."""
    if what != "class" or not inspect.isclass(value):
        return None
    _, args, _ = others
    return ("", None) if _has_fields(value) or value in _PROTOCOLS or args == "(*args, **kwargs)" else None


def _on_bases(app: Any, name: str, value: type, options: Any, bases: list[Any]) -> None:
    bases[:] = _public_bases(value)


def _on_member(app: Any, what: str, name: str, value: Any, skip: Any, options: Any) -> bool | None:
    """Skip what has no docstring, except fields; `skip` is true of what autodoc itself leaves out."""
    if skip or name in _HIDDEN:
        return True
    documented = bool(getattr(value, "__doc__", None))
    return True if inspect.isroutine(value) and not documented else None


def _on_read(app: Any, tree: Any) -> None:
    """Point each type and name to its public entry; what has none is text."""
    from sphinx.addnodes import pending_xref

    for node in [*tree.findall(pending_xref)]:
        if node.get("refdomain") == "py":
            public = find_public(node["reftarget"], node.get("py:module"))
            node["refspecific"] = False
            if public is None:
                node.replace_self(node.children)
            else:
                node["reftarget"] = public


def _on_missing(app: Any, env: Any, node: Any, shown: Any) -> Any:
    """Leave an attribute without an entry as text."""
    return shown if node.get("refdomain") == "py" else None


def connect(app: Any) -> None:
    """Have Sphinx call what is above."""
    app.connect("autodoc-process-docstring", _on_docstring)
    app.connect("autodoc-process-signature", _on_signature)
    app.connect("autodoc-process-bases", _on_bases)
    app.connect("autodoc-skip-member", _on_member)
    app.connect("doctree-read", _on_read)
    app.connect("missing-reference", _on_missing)
