"""The class form of kinds: parameters and state are fields of a class, and the behaviour is its methods.

    @attack("link.drop", …)
    class Drop(OnPath):
        \"\"\"Drops selected frames of a link.\"\"\"

        probability: Number = param("Probability that a frame is dropped.", default=1.0, gt=0, le=1)
        dropped: int = 0

An annotated name in the class is a field. With `param(…)` it is a parameter of scenarios, with another value or
`state(…)` it is state that begins with that value, and without a value it is set in `prepare`. Instances have no other
attributes, so all that they know can be copied, compared and forked.

A decorator such as `attack` checks, makes and registers such a class by `declare`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from copy import deepcopy
from dataclasses import dataclass
from functools import partial
from typing import Any, ClassVar, Final, Self, get_type_hints

from pydantic import Field, create_model, model_validator
from pydantic.fields import FieldInfo
from pydantic_core import PydanticUndefined

from skyrange.contracts.params import Params, refuse
from skyrange.contracts.plugins.registry import Plugin, name_of_module, register
from skyrange.core.errors import InputError, Problem, nearest

MISSING: Final = PydanticUndefined


@dataclass(frozen=True, slots=True)
class Param:
    """A parameter as declared: the constraints, default and description that its model gets."""

    info: FieldInfo


@dataclass(frozen=True, slots=True)
class State:
    """A field that changes during a run; each instance begins with a value of its own."""

    make: Callable[[], Any]


def param(
    description: str,
    *,
    default: Any = MISSING,
    ge: float | None = None,
    gt: float | None = None,
    le: float | None = None,
    lt: float | None = None,
    strict: bool | None = None,
    min_length: int | None = None,
    max_length: int | None = None,
) -> Any:
    """A parameter. `description` begins with what it is; a unit belongs in the field's name as well.

    Without `default` a scenario has to give it. The limits are those of pydantic's `Field`.
    """
    limits: dict[str, Any] = {
        "ge": ge, "gt": gt, "le": le, "lt": lt, "strict": strict, "min_length": min_length, "max_length": max_length,
    }  # fmt: skip
    given = {name: limit for name, limit in limits.items() if limit is not None}
    if default is not MISSING:
        given["default"] = default
    return Param(Field(description=description, **given))


def param_of(kind: Any, default: Any) -> Any:
    """A parameter whose type, an `Annotated` one that other models share, has its description and its limits."""
    return param(kind.__metadata__[-1].description, default=default)


def reads_fields(method: Any, *arguments: Any) -> Any:
    """A method for kinds with the fields that its arguments name; `declare` refuses a kind without one of them."""
    method.field_names = tuple(argument for argument in arguments if isinstance(argument, str))
    return method


def state(make: Callable[[], Any]) -> Any:
    """A field that begins with `make()`, such as `state(dict)`. For a number or a text, `name: int = 0` does."""
    return State(make)


_IMMUTABLE: Final = (bool, int, float, complex, str, bytes, tuple, frozenset, type(None))


def _same(value: Any) -> Any:
    return value


def _is_class_var(hint: Any) -> bool:
    text = hint if isinstance(hint, str) else str(hint)
    return text.startswith(("ClassVar", "typing.ClassVar", "Final", "typing.Final"))


class KindType(type):
    """The type of kinds: makes slots of the annotated names of a class, and keeps what was declared of them."""

    own_params: dict[str, tuple[type, Any, Param]]
    own_state: dict[str, Callable[[], Any]]
    declared_params: dict[str, tuple[type, Any, Param]]
    """By name in order: the class that declares it, the annotation and the parameter, those of bases first."""
    declared_state: dict[str, Callable[[], Any]]
    """By name: what makes its first value. `own_params` and `own_state` are those of the class without its bases."""

    def __new__(mcs, name: str, bases: tuple[type, ...], namespace: dict[str, Any], **options: Any) -> KindType:
        """The class. Raises `InputError` for a mutable default, which instances would share."""
        fields = {key: hint for key, hint in namespace.get("__annotations__", {}).items() if not _is_class_var(hint)}
        values = {key: namespace.pop(key) for key in fields if key in namespace}
        inherited = {key for base in bases for ancestor in base.__mro__ for key in getattr(ancestor, "__slots__", ())}
        hiding = sorted(inherited & namespace.keys() - {"__slots__"})
        namespace.setdefault("__slots__", tuple(key for key in fields if key not in inherited))
        made = super().__new__(mcs, name, bases, namespace, **options)
        if hiding:
            expected = f"an annotation, such as `{hiding[0]}: str = …`, because a base has it as a field"
            raise InputError.one(place_of(made), hiding[0], namespace[hiding[0]], expected)
        made.own_params, made.own_state = {}, {}
        for key, value in values.items():
            if isinstance(value, Param):
                made.own_params[key] = (made, fields[key], value)
            elif isinstance(value, State):
                made.own_state[key] = value.make
            elif isinstance(value, _IMMUTABLE):
                made.own_state[key] = partial(_same, value)
            else:
                raise InputError.one(place_of(made), key, value, "state(…) for what can change, such as state(dict)")
        made.declared_params, made.declared_state = {}, {}
        for ancestor in reversed(made.__mro__):
            if isinstance(ancestor, KindType):  # the nearest class says whether a field is a parameter or state
                made.declared_params |= ancestor.own_params
                made.declared_state |= ancestor.own_state
                for key in ancestor.own_params:
                    made.declared_state.pop(key, None)
                for key in ancestor.own_state:
                    made.declared_params.pop(key, None)
        return made


class Kind(metaclass=KindType):
    """What all kinds share: they are made of parameters, checked by a model that is made of their fields."""

    params_model: ClassVar[type[Params]]
    """The model of its parameters. A decorator such as `attack` makes it."""
    plugin: ClassVar[Any]
    """What is registered under its name: its model, what makes it, and its facts."""
    needs: ClassVar[tuple[str, ...]] = ()
    """Methods that a kind with this base has to define."""

    def __init__(self, **params: Any) -> None:
        """An instance with these parameters and the defaults of others, before `prepare`. Raises `ValidationError`."""
        self._begin(vars(type(self).params_model.model_validate(params)))

    @classmethod
    def of(cls, params: Params) -> Self:
        """An instance of parameters that were validated."""
        made = cls.__new__(cls)
        made._begin(vars(params))
        return made

    def _begin(self, values: Mapping[str, Any]) -> None:
        for name in type(self).declared_params:
            setattr(self, name, values[name])
        for name, make in type(self).declared_state.items():
            setattr(self, name, make())

    def assemble(self, context: Any) -> Any:
        """What it makes in a context. Raises `InputError` for what does not fit the scenario."""
        raise NotImplementedError

    def find_problems(self) -> Iterable[Problem]:
        """What is wrong with the parameters beside each other; the place of a problem is the parameter's name."""
        return ()


def make_params_model(kind: type[Kind]) -> type[Params]:
    """The model of the parameters of a kind. Raises `InputError` for an annotation that cannot be evaluated."""
    fields: dict[str, Any] = {}
    for name, (home, hint, declared) in kind.declared_params.items():
        if not declared.info.description:
            raise InputError.one(place_of(home), name, "no description", "a description of each parameter")
        fields[name] = (_resolve(home, name, hint), declared.info)

    def check(params: Params) -> Params:
        problems = tuple(kind.of(params).find_problems())
        if problems:
            raise refuse(*problems)
        return params

    has_own_check = kind.find_problems is not Kind.find_problems
    validators: Any = {"_fits_together": model_validator(mode="after")(check)} if has_own_check else None
    made: type[Params] = create_model(
        kind.__name__, __base__=Params, __module__=kind.__module__, __doc__=kind.__doc__, __validators__=validators,
        **fields,
    )  # fmt: skip
    made.__qualname__ = f"{kind.__qualname__}.params_model"  # where pickle finds it
    return made


def _resolve(home: type, name: str, hint: Any) -> Any:
    """The type that an annotation of a class means."""
    holder = type(home.__name__, (), {"__annotations__": {name: hint}, "__module__": home.__module__})
    try:
        return get_type_hints(holder, include_extras=True)[name]
    except Exception as error:
        expected = "a type that the module imports, and not for type checkers alone"
        raise InputError.one(place_of(home), name, f"{hint}: {error}", expected) from error


def describe_kind(kind: type) -> str:
    """The first paragraph of its docstring, in one line."""
    return " ".join((kind.__doc__ or "").strip().partition("\n\n")[0].split())


def place_of(kind: type) -> str:
    """Where a class is, for errors: `class Lag in acme.lag`."""
    return f"class {kind.__qualname__} in {kind.__module__}"


def check_copies(kind: Kind) -> None:
    """Raise `InputError` for state of an instance that cannot be copied, by the name of the field."""
    for name in sorted({slot for ancestor in type(kind).__mro__ for slot in getattr(ancestor, "__slots__", ())}):
        if not hasattr(kind, name):
            continue
        value = getattr(kind, name)
        try:
            if getattr(value, "__closure__", None):
                raise TypeError("it is a closure")
            deepcopy(value)
        except Exception as error:
            expected = "data that can be copied: no closure, generator, file or socket"
            raise InputError.one(place_of(type(kind)), name, f"{type(value).__name__}: {error}", expected) from error


@dataclass(frozen=True, slots=True)
class MakeKind:
    """Makes the parts of a kind: an instance with the parameters, assembled in a context."""

    kind: type[Kind]

    def __call__(self, params: Any, context: Any) -> Any:
        """The parts. Raises `InputError` for what does not fit the scenario."""
        return self.kind.of(params).assemble(context)


def declare(
    kind: type, name: str, base: type[Kind], plugin: Callable[..., Plugin[Any, Any]], facts: Mapping[str, Any]
) -> None:
    """Check a class, make the model of its parameters, and register `plugin(params, make, about, **facts)` as `name`.

    Raises `InputError` for a class without the base, a sentence that says what it does, methods that its base needs, or
    fields that a method reads (`fields.reads_fields`); for a name that is not the path of its module; and for
    parameters of which no model can be made.
    """
    where = place_of(kind)
    if not (isinstance(kind, type) and issubclass(kind, base)):
        raise InputError.one(
            where,
            "bases",
            ", ".join(ancestor.__name__ for ancestor in kind.__bases__),
            f"{base.__name__} or one of its bases",
        )
    about = describe_kind(kind) if "__doc__" in vars(kind) else ""
    if not about.endswith("."):
        raise InputError.one(where, "docstring", about or "missing", "a sentence that says what it does")
    for home in kind.__mro__:
        for method in vars(home).get("needs", ()):
            if getattr(kind, method, None) is vars(home).get(method):
                raise InputError.one(where, "methods", "missing", f"{method}, which every {home.__name__} defines")
    for method, made_for in vars(kind).items():
        for field in getattr(made_for, "field_names", ()):
            if not hasattr(kind, field):
                hint = nearest(field, kind.declared_params)
                raise InputError.one(where, method, field, "a parameter or other field of the kind", hint)
    expected = name_of_module(kind.__module__)
    if expected is not None and name != expected:
        raise InputError.one(where, "name", name, f"{expected!r}, the path of its module")
    kind.params_model = make_params_model(kind)
    made = plugin(kind.params_model, MakeKind(kind), about, source=where, **facts)
    register(made.group, name, made, at_home=expected is not None)
    kind.plugin = made


def plugin_of(kind: Any) -> Any:
    """The plugin of a class with a decorator, and a plugin as it is. Raises `InputError` for a class without one."""
    if isinstance(kind, type):
        plugin = vars(kind).get("plugin")
        if plugin is None:
            raise InputError.one(place_of(kind), "decorator", "missing", "a decorator with the name of the kind")
        return plugin
    return kind
