"""What was renamed between two versions: whole words in paths, keys and values."""

import re
from dataclasses import dataclass
from typing import Any

from deblur_avatar.errors import ConfigError


@dataclass(frozen=True)
class Renaming:
    """Old words and what they are called now."""

    words: dict[str, str]

    @classmethod
    def parsed(cls, text: str) -> "Renaming":
        """Of `old=new,old=new`; nothing of an empty text.

        Raises:
            ConfigError: for an entry that is not of this form.
        """
        entries = [entry.strip() for entry in text.split(",") if entry.strip()]
        for entry in entries:
            if not re.fullmatch(r"[^=]+=[^=]+", entry):
                raise ConfigError(f"RENAMED: wanted old=new, got {entry!r}")
        return cls(dict(entry.split("=") for entry in entries))

    def text(self, old: str) -> str:
        """A path, a key or a value by today's words; `no_motion` does not hold `motion`."""
        if not self.words:
            return old
        longest_first = sorted(self.words, key=len, reverse=True)
        pattern = "|".join(map(re.escape, longest_first))
        return re.sub(
            rf"(?<![A-Za-z0-9_])({pattern})(?![A-Za-z0-9_])",
            lambda match: self.words[match[0]],
            old,
        )

    def content(self, old: Any) -> Any:
        """What a file of JSON or YAML holds, by today's words."""
        if isinstance(old, dict):
            return {self.content(key): self.content(value) for key, value in old.items()}
        if isinstance(old, list | tuple):
            return [self.content(value) for value in old]
        return self.text(old) if isinstance(old, str) else old
