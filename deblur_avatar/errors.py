"""Exceptions: the ways in which a run can end early; each is one line and exit code 1.

Ctrl-C is none of them: it says `STOPPED`, with the exit code that shells give it.
"""

INTERRUPTED = 130  # 128 and SIGINT's number
STOPPED = "Stopped. The same command goes on where it stopped."


class ConfigError(ValueError):
    """Parameters, paths or command lines that cannot be run; says which key and what to do."""


class ArtifactError(ValueError):
    """A file that is missing, damaged, of another version or of the wrong content."""


class FittingError(ArithmeticError):
    """Numbers that left the range in which fitting can go on; says which."""
