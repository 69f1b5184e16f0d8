"""Errors of the core: one base; messages name the thing, its value and what is allowed."""

import difflib
from collections.abc import Iterable, Sequence


class TssError(ValueError):
    """Base of every error the core raises; its text is ready to be shown to a user."""


class IntegrationError(TssError):
    """The motion could not be continued (the text says where it stopped and why)."""


class NoSteadyState(TssError):
    """The system has no rotating configuration to start from at this spin rate."""


class Cancelled(TssError):
    """The caller asked a long computation to stop."""


def near_match(word: str, known: Iterable[str]) -> str:
    """ "; did you mean ...?" where a known word is much like this one or holds it, else nothing."""
    known, word = list(known), str(word)
    found = difflib.get_close_matches(word, known, 1)
    found += [name for name in known if len(word) > 2 and f"_{word.lower()}" in f"_{name}"]
    return f"; did you mean {found[0]!r}?" if found else ""


def allowed_words(word: str, known: Iterable[str]) -> str:
    """What follows the words on one that is not known: the nearest of many known ones first."""
    known = list(known)
    allowed, near = ", ".join(known), near_match(word, known)
    return f"{near} Allowed are {allowed}" if near else f"; allowed are {allowed}"


def index_of(what: str, name: str, names: Sequence[str]) -> int:
    """Index of a name.

    Raises
    ------
    TssError
        Naming what it is to be, the name and those that there are.
    """
    if name not in names:
        raise TssError(
            f"{what} is {name!r:.80}; allowed: {', '.join(names):.200}{near_match(name, names)}"
        )
    return names.index(name)
