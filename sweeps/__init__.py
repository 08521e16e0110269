"""Sweeps: tuning hyperparameters per model and input variant, and the ablation, on one machine or many."""

import signal
import sys

from envpred.interrupts import end_at_once

if sys.argv[0] == "-m":  # `python -m sweeps.tune` is being found, and takes seconds to load
    signal.signal(signal.SIGINT, end_at_once)
