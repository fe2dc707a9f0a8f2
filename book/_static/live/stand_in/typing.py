"""What stands in annotations, which nobody reads while a run goes on."""


class NDArray:
    """An array of some kind."""

    def __class_getitem__(cls, _):
        return cls


ArrayLike = NDArray
