"""Errors of the core: one base; messages name the thing, its value and what is allowed."""


class TssError(ValueError):
    """Base of every error the core raises; its text is ready to be shown to a user."""


class IntegrationError(TssError):
    """The motion could not be continued (the text says where it stopped and why)."""


class NoSteadyState(TssError):
    """The system has no rotating configuration to start from at this spin rate."""


class Cancelled(TssError):
    """The caller asked a long computation to stop."""
