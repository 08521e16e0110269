"""The per-drive jobs that turn drives into grids on disk: drive -> mapping -> store."""
