"""What leaves the framework while a drive goes on: forecasts for planners, recordings for other tools."""
