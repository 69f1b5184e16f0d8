"""Files that services name: those of a folder of the node's own, unless its user allows more."""

from pathlib import Path

from tss_ros.core import TssError


def inside(folder: str, file: str | Path, what: str) -> Path:
    """Where a file is, if it is in a folder, links followed.

    Parameters
    ----------
    folder : str
        The parameter `service_folder`; "/" allows every file.
    file : str or Path
    what : str
        What it is, for the error.

    Returns
    -------
    Path
        Absolute and without links.

    Raises
    ------
    TssError
        If it is elsewhere, or has no possible name.
    """
    root = Path(folder).resolve()
    try:
        path = Path(file).resolve()
    except (OSError, ValueError, RuntimeError) as error:
        reason = getattr(error, "strerror", None) or str(error)
        raise TssError(f"{what} {str(file)!r:.200} is no path: {reason}") from None
    if not path.is_relative_to(root):
        raise TssError(
            f"{what} {str(file)!r:.200} is at {str(path)!r:.200}; allowed: files in "
            f"{str(root)!r:.200}, the node's service_folder"
        )
    return path
