"""The gate for what comes from the disk: it is what its schema says, or one line says what is wrong and what to do."""

from envpred.gate.arrays import ArraySchema, map_array, read_array, read_arrays
from envpred.gate.plain import conform, read_json, read_text, read_xml, read_yaml

__all__ = [
    "ArraySchema",
    "conform",
    "map_array",
    "read_array",
    "read_arrays",
    "read_json",
    "read_text",
    "read_xml",
    "read_yaml",
]
