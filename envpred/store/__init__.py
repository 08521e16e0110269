"""Grids on disk: a folder a drive, plain `.npy` files, and a manifest that is written last.

    store/store.json                 format, and for each group of arrays its parameters and their hash
    store/.lock                      held while store.json or a drive's manifest is replaced
    store/.part-...                  a drive or a file that is being written, see `parts`
    store/.checked.json              which files were compared with their checksums, see `checked`
    store/<drive>/manifest.json      frames, stretches, lattice, group -> hash, array -> file, dtype, shape, ...
    store/<drive>/<array>.npy        (<array>.1.npy after the array was built again: the manifest knows)

A group is what one step makes with one set of parameters: `mapping` the label grids and evidence, `context` those of a
wider grid, `dogma` the velocities, `moving` what moves by boxes of tracked objects (`groups.GROUPS`).  A new drive
appears by one rename; a further group, or a drive built again, by one replaced manifest, which alone says what is
valid.  So whatever is interrupted leaves a complete drive or none.
"""

from envpred.store.checked import check_content
from envpred.store.files import FORMAT, MANIFEST, digest
from envpred.store.groups import GROUPS, MAPPING_ARRAYS
from envpred.store.parts import sweep
from envpred.store.reading import Store, StoredDrive
from envpred.store.writing import ArrayWriter, DriveWriter

__all__ = [
    "FORMAT",
    "GROUPS",
    "MANIFEST",
    "MAPPING_ARRAYS",
    "ArrayWriter",
    "DriveWriter",
    "Store",
    "StoredDrive",
    "check_content",
    "digest",
    "sweep",
]
