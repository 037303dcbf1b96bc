"""Loading of a stage: Ctrl-C ends it in one line while torch is loaded, which takes seconds.

A stage's script imports this before all else, for that effect. `run.command` takes over.
"""

import sys
from pathlib import Path

from deblur_avatar.ending import leave_at_once

SCRIPTS = "stages"  # the folder of scripts

# Not where another program has loaded a script to call its `main`.
if Path(getattr(sys.modules["__main__"], "__file__", None) or "").parent.name == SCRIPTS:
    leave_at_once()
