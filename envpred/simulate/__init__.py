"""Drives of our own with known truth: SUMO's traffic, towns drawn from a seed, an HDL-64E, KITTI raw's layout."""
