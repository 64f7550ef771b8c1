"""The log that the ground station of a simulated flight would have written, from the folder of its run."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory

from skyrange.core.errors import InputError, nearest
from skyrange.flightlog.model import FlightLog, Remark
from skyrange.flightlog.tlog import read_tlog
from skyrange.record import load
from skyrange.record.manifest import fleet_of
from skyrange.record.write.files.operator_files import write_operator_files

FORMAT = "run"


def read_run(folder: Path, vehicle: str | None = None) -> FlightLog:
    """The log of `vehicle`, such as blue/b1, or of the first one of a run: what its ground station sent and received.

    Nothing of the truth is in it. Raises `InputError` for a folder that is no run's, or a run without frames or without
    that vehicle.
    """
    record = load(folder)
    who = str(record.path)
    record.tables.require("frames")
    names = fleet_of(record.manifest, who)
    chosen = names[0] if vehicle is None else vehicle
    if chosen not in names:
        raise InputError.one(who, "--vehicle", chosen, "a vehicle of the run", nearest(chosen, names))
    row = record.manifest["vehicles"][names.index(chosen)]
    operator, network = row["operator"], row.get("network", 0)
    name = f"{operator}.net{network}.tlog" if network else f"{operator}.tlog"
    with TemporaryDirectory(prefix="skyrange-") as made:
        write_operator_files(Path(made), record.tables, record.manifest, with_csv=False)
        log = read_tlog(Path(made, name), row.get("system_id", 1))
    remarks = [remark for remark in log.remarks if remark.subject != "vehicles"]
    if vehicle is None and len(names) > 1:
        text = f"{chosen} is read; the run has {len(names)} vehicles. Choose another with --vehicle"
        remarks.insert(0, Remark("vehicles", text))
    return replace(log, path=record.path, format=FORMAT, remarks=remarks)
