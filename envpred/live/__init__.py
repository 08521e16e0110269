"""A drive as it happens: one scan in, one forecast out; and what leaves the framework then, for planners and eyes."""
