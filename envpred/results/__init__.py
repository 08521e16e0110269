"""What runs leave on disk: results of test runs, predictions, and the scenes that pictures show."""
