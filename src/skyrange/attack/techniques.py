"""Published techniques that kinds of attacks are instances of: a pinned table of ids and names.

- MITRE ATT&CK for ICS, version 18.1: all techniques of its STIX 2.1 collection (`ics-attack-18.1.json`) that are
  neither revoked nor deprecated. © The MITRE Corporation, reproduced and distributed with its permission.
- SPARTA, the Aerospace Corporation's matrix of attacks on space systems: those for satellite navigation and sensors,
  for which ATT&CK for ICS has no technique.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final, TypeAlias

from skyrange.core.errors import nearest

NO_FIT: Final = "no fit"
"""The technique of a kind for which neither matrix has one."""


@dataclass(frozen=True, slots=True)
class TechniqueBy:
    """The technique of a kind that depends on a parameter, such as the direction in which frames are dropped."""

    parameter: str
    techniques: Mapping[str, str]
    """By value of the parameter."""


Technique: TypeAlias = str | TechniqueBy
"""The technique of a kind: an id, or ids by the value of a parameter."""


def technique_by(parameter: str, **techniques: str) -> TechniqueBy:
    """The technique of a kind by the value of a parameter: `technique_by("direction", fwd="T0803", rev="T0804")`."""
    return TechniqueBy(parameter, techniques)


def list_techniques(technique: Technique) -> list[str]:
    """The ids that a kind can have, each once."""
    return [technique] if isinstance(technique, str) else list(dict.fromkeys(technique.techniques.values()))


def choose_technique(technique: Technique, params: Mapping[str, Any]) -> str:
    """The id of a kind with these parameters, defaults among them."""
    return technique if isinstance(technique, str) else technique.techniques[params[technique.parameter]]


ATTACK_ICS: Final[Mapping[str, str]] = {
    "T0800": "Activate Firmware Update Mode",
    "T0801": "Monitor Process State",
    "T0802": "Automated Collection",
    "T0803": "Block Command Message",
    "T0804": "Block Reporting Message",
    "T0805": "Block Serial COM",
    "T0806": "Brute Force I/O",
    "T0807": "Command-Line Interface",
    "T0809": "Data Destruction",
    "T0811": "Data from Information Repositories",
    "T0812": "Default Credentials",
    "T0813": "Denial of Control",
    "T0814": "Denial of Service",
    "T0815": "Denial of View",
    "T0816": "Device Restart/Shutdown",
    "T0817": "Drive-by Compromise",
    "T0819": "Exploit Public-Facing Application",
    "T0820": "Exploitation for Evasion",
    "T0821": "Modify Controller Tasking",
    "T0822": "External Remote Services",
    "T0823": "Graphical User Interface",
    "T0826": "Loss of Availability",
    "T0827": "Loss of Control",
    "T0828": "Loss of Productivity and Revenue",
    "T0829": "Loss of View",
    "T0830": "Adversary-in-the-Middle",
    "T0831": "Manipulation of Control",
    "T0832": "Manipulation of View",
    "T0834": "Native API",
    "T0835": "Manipulate I/O Image",
    "T0836": "Modify Parameter",
    "T0837": "Loss of Protection",
    "T0838": "Modify Alarm Settings",
    "T0839": "Module Firmware",
    "T0840": "Network Connection Enumeration",
    "T0842": "Network Sniffing",
    "T0843": "Program Download",
    "T0845": "Program Upload",
    "T0846": "Remote System Discovery",
    "T0847": "Replication Through Removable Media",
    "T0848": "Rogue Master",
    "T0849": "Masquerading",
    "T0851": "Rootkit",
    "T0852": "Screen Capture",
    "T0853": "Scripting",
    "T0855": "Unauthorized Command Message",
    "T0856": "Spoof Reporting Message",
    "T0857": "System Firmware",
    "T0858": "Change Operating Mode",
    "T0859": "Valid Accounts",
    "T0860": "Wireless Compromise",
    "T0861": "Point & Tag Identification",
    "T0862": "Supply Chain Compromise",
    "T0863": "User Execution",
    "T0864": "Transient Cyber Asset",
    "T0865": "Spearphishing Attachment",
    "T0866": "Exploitation of Remote Services",
    "T0867": "Lateral Tool Transfer",
    "T0868": "Detect Operating Mode",
    "T0869": "Standard Application Layer Protocol",
    "T0871": "Execution through API",
    "T0872": "Indicator Removal on Host",
    "T0873": "Project File Infection",
    "T0874": "Hooking",
    "T0877": "I/O Image",
    "T0878": "Alarm Suppression",
    "T0879": "Damage to Property",
    "T0880": "Loss of Safety",
    "T0881": "Service Stop",
    "T0882": "Theft of Operational Information",
    "T0883": "Internet Accessible Device",
    "T0884": "Connection Proxy",
    "T0885": "Commonly Used Port",
    "T0886": "Remote Services",
    "T0887": "Wireless Sniffing",
    "T0888": "Remote System Information Discovery",
    "T0889": "Modify Program",
    "T0890": "Exploitation for Privilege Escalation",
    "T0891": "Hardcoded Credentials",
    "T0892": "Change Credential",
    "T0893": "Data from Local System",
    "T0894": "System Binary Proxy Execution",
    "T0895": "Autorun Image",
}

SPARTA: Final[Mapping[str, str]] = {
    "EX-0014.01": "Spoofing: Time Spoof",
    "EX-0014.03": "Spoofing: Sensor Data",
    "EX-0014.04": "Spoofing: Position, Navigation, and Timing (PNT)",
    "EX-0016.03": "Jamming: Position, Navigation, and Timing (PNT)",
}


def describe_technique(technique: Technique) -> str:
    """Matrix, id and name of a technique, such as "ATT&CK for ICS T0814, Denial of Service".

    Of one that depends on a parameter it is that of each value. Raises `ValueError` for an id that neither matrix has.
    """
    if isinstance(technique, TechniqueBy):
        texts = [f"{describe_technique(alternative)} ({value})" for value, alternative in technique.techniques.items()]
        return f"by {technique.parameter}: {'; '.join(texts)}"
    if technique == NO_FIT:
        return "no technique of ATT&CK for ICS or SPARTA fits"
    if technique in ATTACK_ICS:
        return f"ATT&CK for ICS {technique}, {ATTACK_ICS[technique]}"
    if technique in SPARTA:
        return f"SPARTA {technique}, {SPARTA[technique]}"
    raise ValueError(f"no technique {technique!r}{nearest(technique, [*ATTACK_ICS, *SPARTA])}")
