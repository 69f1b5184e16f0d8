"""The key `failures` of a scenario file: what fails, and when or on what event.

failures:
  - {at_s: 5000.0, cut: tether_1}
  - {when: {tether: tether_2, tension_n: 12.0}, dead: satellite_2}
  - {when: {tether: tether_3, slack: true}, stuck: satellite_3}
"""

from tss_ros.core import Failure, TssError
from tss_ros.core.arguments import finite
from tss_ros.core.model.failures import KINDS
from tss_ros.scenarios import files

#: Most failures of a scenario.
MOST_FAILURES = 1000


def read_failures(content: object) -> tuple[Failure, ...]:
    """The failures that a scenario file declares.

    Parameters
    ----------
    content : object
        What the file has for the key.

    Returns
    -------
    tuple of Failure
        Names are not held against any system.

    Raises
    ------
    TssError
        Naming the entry, the value and what is allowed.
    """
    if not isinstance(content, list) or len(content) > MOST_FAILURES:
        raise TssError(
            f"failures must be a list of at most {MOST_FAILURES} entries, got {content!r:.80}"
        )
    return tuple(_failure(f"failures[{i}]", entry) for i, entry in enumerate(content))


def _failure(where, entry):
    files.check_keys(where, entry, (), ("at_s", "when", *KINDS))
    kinds = [kind for kind in KINDS if kind in entry]
    if len(kinds) != 1:
        raise TssError(f"{where} must have one of {', '.join(KINDS)}, got {entry!r:.120}")
    (kind,) = kinds
    event = {}
    if ("at_s" in entry) == ("when" in entry):
        raise TssError(f"{where} must have either at_s or when, got {entry!r:.120}")
    if "at_s" in entry:
        event["at_s"] = finite(f"{where}.at_s", entry["at_s"], at_least=0.0)
    else:
        event |= _event(f"{where}.when", entry["when"])
    try:
        return Failure(kind, str(entry[kind]), **event)
    except TssError as error:
        raise TssError(f"{where}: {error}") from None


def _event(where, entry):
    files.check_keys(where, entry, ("tether",), ("tension_n", "slack"))
    if ("tension_n" in entry) == ("slack" in entry):
        raise TssError(f"{where} must have either tension_n or slack, got {entry!r:.120}")
    if "slack" in entry and entry["slack"] is not True:
        raise TssError(f"{where}.slack is {entry['slack']!r:.80}; allowed: true")
    event = {"tether": str(entry["tether"])}
    if "tension_n" in entry:
        event["tension_n"] = finite(f"{where}.tension_n", entry["tension_n"])
    return event
