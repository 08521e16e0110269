"""Sweeps: tuning hyperparameters per model and input variant, and the ablation, on one machine or many."""
