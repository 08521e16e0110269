"""Plans of runs: the ablation as a table, the grids that it needs, how long it takes, what came out."""
