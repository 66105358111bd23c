"""Which entries of a global matrix the element matrices fill, and where each of theirs goes: linear in the entries."""

import numpy as np

from fieldmap.kernels.compilation import njit


@njit
def _elements_of(unknowns, count):
    """Elements of each unknown, one unknown after the other: start (n + 1,), elements."""
    start = np.zeros(count + 1, np.int64)
    for e in range(unknowns.shape[0]):
        for a in range(unknowns.shape[1]):
            start[unknowns[e, a] + 1] += 1
    for i in range(count):
        start[i + 1] += start[i]
    elements, filled = np.empty(start[count], np.int64), start[:-1].copy()
    for e in range(unknowns.shape[0]):
        for a in range(unknowns.shape[1]):
            i = unknowns[e, a]
            elements[filled[i]] = e
            filled[i] += 1
    return start, elements


@njit
def _sort(values, count):
    """Put the first `count` values in rising order: a few tens of them, by insertion."""
    for k in range(1, count):
        value, at = values[k], k
        while at > 0 and values[at - 1] > value:
            values[at] = values[at - 1]
            at -= 1
        values[at] = value


@njit
def sparse_pattern(unknowns, count):
    """Rows of the sum of element matrices: pointer (n + 1,), columns rising in each row, and place (e, k, k): the entry
    to which each number of an element matrix is added.

    unknowns (e, k): numbers below `count` of every element's unknowns, all different.
    """
    start, elements = _elements_of(unknowns, count)
    width = unknowns.shape[1]
    seen, entry = np.full(count, -1), np.empty(count, np.int64)
    pointer = np.zeros(count + 1, np.int64)
    for i in range(count):
        found = 0
        for e in elements[start[i] : start[i + 1]]:
            for b in range(width):
                j = unknowns[e, b]
                if seen[j] != i:
                    seen[j] = i
                    found += 1
        pointer[i + 1] = pointer[i] + found
    columns = np.empty(pointer[count], np.int64)
    place = np.empty((unknowns.shape[0], width, width), np.int64)
    seen[:] = -1
    for i in range(count):
        row, found = columns[pointer[i] : pointer[i + 1]], 0
        for e in elements[start[i] : start[i + 1]]:
            for b in range(width):
                j = unknowns[e, b]
                if seen[j] != i:
                    seen[j] = i
                    row[found] = j
                    found += 1
        _sort(row, found)
        for k in range(found):
            entry[row[k]] = pointer[i] + k
        for e in elements[start[i] : start[i + 1]]:
            for a in range(width):
                if unknowns[e, a] == i:
                    for b in range(width):
                        place[e, a, b] = entry[unknowns[e, b]]
    return pointer, columns, place
