"""The compiled code of a worker process: importing this module loads it.

A fork server imports it once, before it forks the first worker, and all workers inherit it. The coordinator never
does, so that creating a pool costs it nothing.
"""

from .sah.steps import warm_up

warm_up()
