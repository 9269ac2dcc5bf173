"""One sentence for the user about something that is no error, such as a cache that cannot be used.

It goes to the logger ``clbvh``, which prints it on stderr unless the program has set up its own logging.
"""

from __future__ import annotations

import hashlib
import os

# What has been said, by this process or by one that started it: workers must not repeat it.
_VARIABLE = "_CLBVH_SAID"
_DIGITS = 8


def say_once(sentence: str, about: str = "") -> None:
    """Log a warning, unless this process or one that started it has done so.

    Sentences about the same thing count as one; without `about`, equal sentences do.
    """
    digest = hashlib.sha256((about or sentence).encode(errors="surrogateescape")).hexdigest()[:_DIGITS]
    said = os.environ.get(_VARIABLE, "")
    if digest in said.split(","):
        return
    os.environ[_VARIABLE] = f"{said},{digest}"
    import logging  # takes 10 ms, and most processes have nothing to say

    logging.getLogger("clbvh").warning("clbvh: %s", sentence)
