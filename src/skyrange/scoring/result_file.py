"""Result file of a scoring: the model of the JSON document `skyrange.scores/4`, its writer and its reader.

Whoever scores detectors on the same study with other software can write such a file, and put it beside others.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Final, Literal

from pydantic import Field, ValidationError

from skyrange.core.errors import InputError
from skyrange.core.files import MAX_TEXT_BYTES, atomic_write, parse_json, read_input
from skyrange.scenario.model.base import Model
from skyrange.scenario.validation.error_messages import input_error

FORMAT: Final = "skyrange.scores/4"
"""Value of `format`; the number increases when keys change or numbers have another meaning. No other is read."""
OpenLimits = tuple[float, float | None]
"""Lower and upper limit of an interval; an upper limit of null is infinite."""


class ScoreSettings(Model):
    """Conventions of a scoring. The defaults are choices of this project, not taken from a standard."""

    target_per_h: float = Field(
        default=1.0, gt=0, description="False alarms per aircraft-hour at which thresholds are chosen."
    )
    episode_s: float = Field(
        default=30.0, ge=1e-3, le=1e6, description="Alerts about an aircraft within so many seconds are one alarm."
    )
    grace_s: float = Field(
        default=10.0,
        ge=0,
        le=1e6,
        description="Seconds after the stop of an attack, or the end of its effect, in which alarms still detect it.",
    )
    horizon_s: float = Field(default=60.0, gt=0, description="Horizon of the restricted mean of delays, in seconds.")
    confidence: float = Field(default=0.95, gt=0.5, lt=1, description="Confidence of all intervals.")
    variation: float = Field(
        default=2.0,
        ge=0,
        le=100,
        description="Coefficient of variation of the false-alarm rate between clusters that limits take for granted; "
        "more where the flights show more.",
    )
    replicates: int = Field(default=1000, ge=100, le=100_000, description="Replicates of the bootstrap.")
    seed: int = Field(default=0, ge=0, lt=2**64, description="Seed of the bootstrap and of replays by chance.")
    prevalences_per_h: tuple[Annotated[float, Field(gt=0)], ...] = Field(
        default=(1e-1, 1e-2, 1e-3, 1e-4),
        description="Attacks per aircraft-hour at which precision is stated.",
    )


class Estimate(Model):
    """A ratio with its intervals."""

    value: float = Field(description="The ratio that was observed.")
    exact: OpenLimits = Field(
        description="Clopper-Pearson's interval of a proportion, or Garwood's of a rate, as if counts were independent."
    )
    clustered: OpenLimits | None = Field(
        description="The interval if flights of a cluster are alike: Korn and Graubard's of a proportion, that of a "
        "negative binomial number of alarms for a rate; null with fewer than two clusters."
    )


class FalseAlarms(Model):
    """False alarms about the aircraft of one kind of flights."""

    episodes: int = Field(ge=0, description="Number of false alarms.")
    hours: float = Field(
        ge=0,
        description="Aircraft-hours, each flight once, without the time before a run differs from the nominal one of "
        "its block, and without that in which attacks or harmless intrusions act on the aircraft.",
    )
    per_h: Estimate | None = Field(description="False alarms per aircraft-hour; null without hours.")


class FalseAlarmsByFlights(Model):
    """False alarms by kind of flight."""

    nominal: FalseAlarms = Field(description="Flights of the arm 'nominal': the rate of claims and of precision.")
    sham: FalseAlarms = Field(description="Other flights without attack or fault, such as shams.")
    fault: FalseAlarms = Field(description="Flights with a benign fault.")
    hostile: FalseAlarms = Field(description="Attacked runs, outside of attacks.")


class Claim(Model):
    """Whether the nominal flights show that the false-alarm rate is at most the target."""

    lowest_per_h: float | None = Field(
        description="The least rate that the nominal flights can support, without any alarm. null without hours."
    )
    upper_per_h: float | None = Field(
        description="One-sided upper limit of the rate: the larger of the next two. null without hours."
    )
    poisson_upper_per_h: float | None = Field(description="Garwood's, if all flights have the same rate.")
    clustered_upper_per_h: float | None = Field(description="The limit if rates differ between clusters.")
    verdict: Literal["claimed", "not shown", "exceeded", "cannot be claimed"] = Field(
        description="claimed: the upper limit is at most the target. not shown: the target is within the limits. "
        "exceeded: the interval is above the target. cannot be claimed: there are too few hours for this target, "
        "whatever the detector does."
    )


class Delay(Model):
    """Time from `observable` to the detection, with misses as censored; seconds."""

    median_s: float | None = Field(
        description="Kaplan-Meier median; null unless more than half of the attacks are detected."
    )
    median_clusters: OpenLimits | None = Field(
        description="Its interval by resampling clusters; null with fewer than 40, of which it covers too rarely."
    )
    restricted_mean_s: float = Field(description="Mean of min(delay, horizon), by the area below the curve.")
    restricted_mean_clusters: OpenLimits | None = Field(
        description="Its interval by resampling clusters; null with fewer than 40."
    )
    horizon_s: float = Field(description="The horizon: that of the settings, or the longest window if that is shorter.")


class BeforeEffect(Model):
    """Whether there was time to act: detections before the first effect on the outcome."""

    attacks: int = Field(ge=0, description="Observable attacks with an effect.")
    unavoidable: int = Field(ge=0, description="Of these, attacks whose effect is not later than they are observable.")
    share: Estimate = Field(description="Of these, the share that was detected before the effect.")
    lead_quartiles_s: tuple[float | None, float | None, float | None] = Field(
        description="Quartiles of effect − detection over all of these: negative if later, null if it was missed."
    )


class Detection(Model):
    """What was detected of some attacks."""

    attacks: int = Field(ge=0, description="Number of attacks.")
    unobservable: int = Field(ge=0, description="Of these, attacks that the sensor could not see: not in the recall.")
    detected: int = Field(ge=0, description="Number of observable attacks that were detected.")
    recall: Estimate | None = Field(description="Share of the observable ones that was detected; null without any.")
    by_chance: float | None = Field(
        description="Recall of the alarms of nominal flights, replayed against the same attacks with other onsets; "
        "null without nominal flights."
    )
    delay: Delay | None = Field(description="Delays; null without observable attacks.")
    before_effect: BeforeEffect | None = Field(description="Detections before effects; null without any effect.")


class GroupDetection(Detection):
    """What was detected of the attacks of one kind or family."""

    name: str = Field(description="The kind or the family.")


class Precision(Model):
    """Of the alarms, the share that is about an attack, at a prevalence."""

    prevalence_per_h: float = Field(gt=0, description="Attacks per aircraft-hour.")
    value: float | None = Field(description="The share; null if there were no alarms at all.")
    limits: tuple[float, float] = Field(description="Its interval, from those of recall and rate (Bonferroni).")


class EqualRate(Model):
    """Detection at the lowest threshold with which a detector keeps to the target rate on the nominal flights of a set.

    It is chosen on the flights on which it is compared, so it tells which of two detectors finds more at the same rate,
    and not what one finds with the threshold that it has.
    """

    threshold: float | None = Field(description="Alerts with a score above it are alarms; null: all are, or none.")
    episodes: int = Field(ge=0, description="False alarms on the nominal flights of the set.")
    per_h: float = Field(ge=0, description="Their rate: the target, or as near below it as the scores allow.")
    recall: float = Field(description="Share of the observable attacks that is detected.")
    restricted_mean_s: float = Field(description="Mean of min(delay, horizon), misses included.")


class HarmlessIntrusions(Model):
    """Alarms about acts of somebody unauthorised that harm nobody: neither detections nor false alarms."""

    intrusions: int = Field(ge=0, description="Number of harmless intrusions, one for each aircraft.")
    reported: int = Field(ge=0, description="Of these, those about which there was an alarm, from onset to grace.")
    share: Estimate | None = Field(description="The share about which there was an alarm; null without any intrusion.")


class SetScore(Model):
    """Scores on a part of the test flights or attacks."""

    name: str = Field(description="The set: 'all', or 'held-out' or 'seen' with what was held out.")
    runs: int = Field(ge=0, description="Number of runs.")
    blocks: int = Field(ge=0, description="Number of blocks.")
    clusters: int = Field(ge=0, description="Number of clusters of blocks: independent samples.")
    false_alarms: FalseAlarmsByFlights = Field(description="By kind of flight.")
    claim: Claim = Field(description="What the nominal flights show.")
    detection: Detection = Field(description="Over all attacks.")
    kinds: tuple[GroupDetection, ...] = Field(description="By kind of attack.")
    families: tuple[GroupDetection, ...] = Field(description="By family of attacks.")
    harmless_intrusions: HarmlessIntrusions = Field(description="Of the flights of the set.")
    precision: tuple[Precision, ...] = Field(
        description="Precision at each prevalence; empty without hours or attacks."
    )
    equal_rate: EqualRate | None = Field(
        description="Recall and delay at a rate at which all detectors are compared; null without nominal hours or "
        "attacks."
    )


class Threshold(Model):
    """The threshold of a detector, and what it was chosen on."""

    value: float | None = Field(description="Alerts with a score above it are alarms; null: all are.")
    reached: FalseAlarms = Field(
        description="False alarms on the nominal and fault flights of the validation at this threshold. Its limits say "
        "how far the rate on other flights may be from the target."
    )
    lowest_per_h: float | None = Field(description="The least rate that these flights can support, without any alarm.")


class DetectorScore(Model):
    """All scores of one detector."""

    detector: str = Field(min_length=1, description="Its name.")
    trivial: bool = Field(description="Whether it is a trivial detector, which looks at nothing.")
    reduced: str = Field(
        default="",
        description="What it lacks of the published method that it is named after; rankings mark it then. Empty: "
        "nothing, or it is named after none.",
    )
    threshold: Threshold | None = Field(description="Its threshold; null for a trivial detector.")
    sets: tuple[SetScore, ...] = Field(
        min_length=1,
        description="Scores on all of the test, and on parts of it, with windows that end when attacks stop to act.",
    )
    effect_sets: tuple[SetScore, ...] = Field(
        min_length=1, description="The same with windows that end when effects do, at the same threshold."
    )

    def on(self, name: str) -> SetScore | None:
        """The scores on the set `name`; None if there are none."""
        return next((score_set for score_set in self.sets if score_set.name == name), None)

    def effect_on(self, name: str) -> SetScore | None:
        """The scores on the set `name` with windows that last as long as effects; None if there are none."""
        return next((score_set for score_set in self.effect_sets if score_set.name == name), None)


class HeldOut(Model):
    """What is in the test part, but neither in training nor in validation."""

    kinds: tuple[str, ...] = Field(description="Kinds of attacks.")
    families: tuple[str, ...] = Field(description="Families of attacks.")
    cities: tuple[str, ...] = Field(description="Cities.")
    aircraft: tuple[int, ...] = Field(description="Numbers of aircraft of a run.")


class ScoreFile(Model):
    """Scores of detectors on one study."""

    format: Literal["skyrange.scores/4"] = Field(default=FORMAT, description="The format of this file.")
    study: str = Field(description="Name of the study.")
    digest: str = Field(description="Digest of the study's flights and attacks: equal for the same study.")
    software: str = Field(description="What computed the scores, with its version.")
    settings: ScoreSettings = Field(description="The conventions.")
    held_out: HeldOut = Field(description="What the test part has that the others do not.")
    repeated_runs: int = Field(ge=0, description="Runs that are the same flight as another one, and do not count.")
    detectors: tuple[DetectorScore, ...] = Field(description="The detectors, by name.")


def write_scores(scores: ScoreFile, path: Path) -> None:
    """Write the scores to a file, as JSON. Raises OSError if it cannot be written."""
    with atomic_write(path) as file:
        file.write((scores.model_dump_json(indent=1) + "\n").encode())


def read_scores(path: Path) -> ScoreFile:
    """The scores in a file. Raises InputError if it cannot be read, or is not such a file."""
    who = str(path)
    data: Any = parse_json(read_input(path, who, max_bytes=MAX_TEXT_BYTES, expected="a file of scores"), who, "file")
    file_format = data.get("format") if isinstance(data, dict) else None
    if file_format != FORMAT:
        hint = "Score the study again." if str(file_format).startswith("skyrange.scores/") else ""
        raise InputError.one(
            who, "format", "not there" if file_format is None else repr(file_format), f'"{FORMAT}"', hint
        )
    try:
        return ScoreFile.model_validate(data)
    except ValidationError as error:
        raise input_error(who, error, ScoreFile, data) from None
