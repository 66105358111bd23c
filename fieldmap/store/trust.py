"""What a reader takes from a map file: objects at hard links, arrays that are wholly in the file and as large as it
says, and nothing else. All of it is checked before memory is asked for or a number is read."""

import h5py

from fieldmap.store.seal import REMAKE

_NAMES = {"f": "float64 numbers", "fi": "numbers", "u": "flags", "S": "text of fixed length"}


class Refused(Exception):  # noqa: N818 - internal, turned into MapFileError by the reader
    """A check failed: what must hold, what was found, remedy."""


def hard(file: h5py.Group, path: str) -> h5py.Group | h5py.Dataset:
    """The object at a path of hard links: nothing is taken from elsewhere."""
    here: h5py.Group | h5py.Dataset = file
    for name in path.strip("/").split("/"):
        if not is_hard(here, name):
            raise Refused(f"{path} inside the file", f"a link, or nothing, at {here.name}", REMAKE)
        here = here[name]
    return here


def is_hard(group: h5py.Group | h5py.Dataset, name: str) -> bool:
    """Whether a group has an object of its own by that name; does not follow links to find out."""
    return isinstance(group, h5py.Group) and isinstance(group.get(name, getlink=True), h5py.HardLink)


def stored(file: h5py.Group, path: str, kinds: str) -> h5py.Dataset:
    """The data set at a path of hard links, all of whose bytes lie in this file.

    kinds: its type must be one of these of numpy (a key of _NAMES). Refused are numbers kept in other files, filters
    other than checksums (a few bytes could declare any size), arrays larger than what is stored of them, and numbers
    that stand in several places (those of one component in that of another).
    """
    data = hard(file, path)
    if not isinstance(data, h5py.Dataset) or data.dtype.kind not in kinds or data.dtype.hasobject:
        raise Refused(f"{path}: {_NAMES[kinds]}", _kind_of(data), REMAKE)
    if data.is_virtual or data.external:
        raise Refused(f"{path} inside the file", "numbers kept in another file", REMAKE)
    if h5py.h5o.get_info(data.id).rc != 1:
        raise Refused(f"{path}: numbers of its own", "numbers that have another name as well", REMAKE)
    plist = data.id.get_create_plist()
    filters = {plist.get_filter(k)[0] for k in range(plist.get_nfilters())}
    if not filters <= {h5py.h5z.FILTER_FLETCHER32}:
        raise Refused(
            f"{path}: stored as it is, with checksums at most", "a compressed or filtered array", REMAKE
        )
    if data.shape is None or data.nbytes > data.id.get_storage_size():
        received = f"shape {data.shape} with {data.id.get_storage_size()} bytes stored"
        raise Refused(f"{path}: all of its numbers stored", received, REMAKE)
    return data


def _kind_of(data: h5py.Group | h5py.Dataset) -> str:
    return f"shape {data.shape}, {data.dtype}" if isinstance(data, h5py.Dataset) else "no data set"
