"""How good a forecast is: one metric a file, each with its definition and source."""
