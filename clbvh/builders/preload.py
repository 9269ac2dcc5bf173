"""The compiled code of a worker process: importing this module loads it.

A fork server imports it once, before it forks the first worker, and all workers inherit it. The coordinator never
does, so that creating a pool costs it nothing.
"""

import numpy as np

from .sah.steps import warm_up
from .workers.task_counter import take_number

warm_up()
take_number(np.zeros(1, np.int64))
