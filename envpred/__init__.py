"""Evidential occupancy grids from LiDAR drives, and their forecasts."""

__version__ = "0.1.0"
