"""What every worker process needs in memory; importing this module loads it.

A fork server imports it once, before it forks the first worker, and all workers inherit it. The coordinator never
does, so that creating a pool costs it nothing.
"""

from .steps import warm_up

warm_up()
