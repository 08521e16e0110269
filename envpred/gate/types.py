"""Types that schemas are made of.

Schemas are classes of `msgspec`: what stands in a file beside what they name is left alone, and `ValueError` in
`__post_init__` says what does not fit together.
"""

from typing import Annotated

from msgspec import Meta

Line = Annotated[str, Meta(pattern=r"\A[^\x00-\x1f\x7f]*\Z", max_length=100_000)]  # text that a line can repeat
Key = Annotated[str, Meta(pattern=r"\A\w[\w.-]*\Z", max_length=200)]  # also part of the name of a file
Place = Annotated[
    str, Meta(pattern=r"\A[^\x00-\x1f\x7f]+\Z", max_length=1000)
]  # of a file, see `envpred.store.files.inside`
Count = Annotated[int, Meta(ge=0, le=2**40)]
Number = Annotated[float, Meta(ge=-1e12, le=1e12)]  # which also keeps out what is none
Positive = Annotated[float, Meta(gt=0, le=1e12)]
Length = Annotated[float, Meta(gt=1e-4, le=1e4)]  # of cells in metres, and of steps in seconds
Cells = Annotated[int, Meta(ge=2, le=2**15, multiple_of=2)]
Checksum = Annotated[int, Meta(ge=0, lt=2**32)]
Point = tuple[Number, Number]
Row = tuple[Number, Number, Number, Number]
Values = list[Number | None]  # None where undefined
