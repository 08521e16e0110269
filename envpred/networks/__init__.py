"""Torch modules that know no Lightning and no files."""
