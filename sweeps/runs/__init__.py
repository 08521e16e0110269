"""One run of envpred in a process of its own: its command, its folder, what it tells."""
