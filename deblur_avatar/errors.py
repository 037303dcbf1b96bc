"""The two ways in which a caller of the pipeline can be wrong."""


class ConfigError(ValueError):
    """Parameters, paths or command lines that cannot be run; says which key and what to do."""


class ArtifactError(ValueError):
    """A file that is missing, damaged, of another version or of the wrong content."""
