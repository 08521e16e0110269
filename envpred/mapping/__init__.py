"""Arrays in, arrays out: one method of the literature per file, no files and no Lightning."""
