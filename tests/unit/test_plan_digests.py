"""Digests of plans: what decides the runs is in them, and a key that a later version adds is not until it is used."""

from __future__ import annotations

from pydantic import BaseModel

from skyrange.study.execution.plan import describe_decided


class Link(BaseModel):
    loss: float = 0.0
    band: str | None = None


class Before(BaseModel):
    name: str
    seeds: list[int] | None = None
    link: Link = Link()
    links: list[Link] = []


class LinkAfter(Link):
    signed: bool = False
    keys: list[str] = []


class After(Before):
    link: LinkAfter = LinkAfter()
    links: list[LinkAfter] = []  # type: ignore[assignment]
    sensors: list[str] = []
    fusion: str | None = None


def test_a_key_that_is_new_and_unused_changes_nothing() -> None:
    told = {"name": "a", "links": [{"loss": 1.0}, {}], "link": {"band": "5 GHz"}}
    assert describe_decided(Before.model_validate(told)) == describe_decided(After.model_validate(told))
    assert describe_decided(Before(name="a")) == describe_decided(After(name="a"))


def test_all_that_is_set_is_in_it() -> None:
    told: list[dict[str, object]] = [
        {}, {"seeds": []}, {"sensors": ["lidar"]}, {"fusion": "sight"}, {"link": {"loss": 0.5}},
        {"link": {"signed": True}}, {"link": {"keys": ["k"]}}, {"links": [{}]}, {"links": [{}, {}]},
        {"links": [{"signed": True}, {}]}, {"links": [{}, {"signed": True}]}, {"links": [{"band": ""}]},
    ]  # fmt: skip
    assert len({describe_decided(After.model_validate({"name": "a", **more})) for more in told}) == len(told)


def test_a_default_that_is_something_is_in_it() -> None:
    assert '"loss": 0.0' in describe_decided(Before(name="a"))
