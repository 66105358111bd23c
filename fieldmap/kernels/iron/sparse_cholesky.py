"""Cholesky factors of sparse matrices by fronts (the multifrontal method), for many matrices of one pattern.

Columns of the factor with the same rows below form a supernode. Its front is a dense matrix over these rows: the
entries of the matrix in the columns of the supernode, and the contributions of its children in the elimination tree.
Eliminating the columns leaves a contribution to the parent. (Duff and Reid, ACM Trans. Math. Softw. 9 (1983) 302; Liu,
SIAM Review 34 (1992) 82.) Nearly all work is done on rows of dense matrices.

The columns of supernode s are start[s] to start[s + 1]; its rows, its own columns first, are
rows[row_start[s]:row_start[s + 1]]; parent[s] is its parent or -1. Supernodes are numbered so that children come before
their parent, one subtree after the other.
"""

import math

import numpy as np

from fieldmap.kernels.compilation import inlined, njit

# Rows that are eliminated one by one before they are subtracted together from the rows below.
_UNROLLED = 4
_FAST = {"nsz", "arcp", "contract", "afn", "reassoc"}


@njit(nogil=True)
def elimination_tree(pointer, index):
    """Parents (n,) of the columns, -1 for roots, from the pattern of the strict lower triangle by rows.

    J. W. H. Liu, ACM Trans. Math. Softw. 12 (1986) 127, with path compression.
    """
    n = pointer.size - 1
    parent = np.full(n, -1, np.int64)
    ancestor = np.full(n, -1, np.int64)
    for i in range(n):
        for p in range(pointer[i], pointer[i + 1]):
            j = index[p]
            while j != -1 and j < i:
                following = ancestor[j]
                ancestor[j] = i
                if following == -1:
                    parent[j] = i
                    break
                j = following
    return parent


@njit(nogil=True)
def postorder(parent):
    """Order (n,) in which every node of the forest comes after its children, one subtree after the other."""
    n = parent.size
    first, following = np.full(n, -1, np.int64), np.full(n, -1, np.int64)
    for j in range(n - 1, -1, -1):
        if parent[j] != -1:
            following[j] = first[parent[j]]
            first[parent[j]] = j
    order, stack = np.empty(n, np.int64), np.empty(n, np.int64)
    count = 0
    for root in range(n):
        if parent[root] != -1:
            continue
        top, stack[0] = 0, root
        while top >= 0:
            j = stack[top]
            child = first[j]
            if child == -1:
                order[count] = j
                count += 1
                top -= 1
            else:
                first[j] = following[child]
                top += 1
                stack[top] = child
    return order


@njit(nogil=True)
def column_counts(pointer, index, parent):
    """Entries (n,) of every column of the factor, the diagonal too; pattern and parents as in `elimination_tree`."""
    n = parent.size
    count, seen = np.ones(n, np.int64), np.full(n, -1, np.int64)
    for i in range(n):
        seen[i] = i
        for p in range(pointer[i], pointer[i + 1]):
            j = index[p]
            # Row i has an entry in every column on the path from j to i.
            while seen[j] != i:
                seen[j] = i
                count[j] += 1
                j = parent[j]
    return count


@njit(nogil=True)
def join_supernodes(start, parent, size, widths, shares):
    """Join supernodes with the last of their children, whose columns lie right before theirs, while the share of zeros
    in their columns stays below shares[k] for joined widths up to widths[k].

    start (m + 1,), parent (m,) and size (m,), the numbers of rows. Returns the first columns (m,), the numbers of rows
    (m,), and the supernode that each is now a part of (m,).
    """
    nodes = parent.size
    begin, end, size = start[:-1].copy(), start[1:], size.copy()
    into, zeros = np.arange(nodes), np.zeros(nodes, np.int64)
    last = np.full(start[-1] + 1, -1, np.int64)
    for s in range(nodes):
        last[end[s]] = s
        while True:
            child = last[begin[s]]
            if child == -1 or parent[child] == -1:
                break
            above = parent[child]
            while into[above] != above:
                above = into[above]
            if above != s:
                break
            narrow = end[child] - begin[child]
            width, rows = end[s] - begin[child], narrow + size[s]
            added = zeros[child] + zeros[s] + narrow * (rows - size[child])
            k = 0
            while width > widths[k]:
                k += 1
            if added > shares[k] * width * rows:
                break
            into[child], begin[s], size[s], zeros[s] = s, begin[child], rows, added
    for s in range(nodes - 1, -1, -1):
        into[s] = into[into[s]]
    return begin, size, into


@njit(nogil=True)
def supernode_rows(start, column_pointer, column_index, parent_of_node, row_start):
    """Rows of every supernode, its own columns first and then the others in no order. column_pointer, column_index:
    pattern of the lower triangle by columns, with the diagonal; row_start (m + 1,): where the rows of each
    supernode begin."""
    nodes, n = start.size - 1, start[-1]
    rows = np.empty(row_start[-1], np.int64)
    seen = np.full(n, -1, np.int64)
    first, following = np.full(nodes, -1, np.int64), np.full(nodes, -1, np.int64)
    for s in range(nodes):
        place = row_start[s]
        for j in range(start[s], start[s + 1]):
            seen[j] = s
            rows[place] = j
            place += 1
        for j in range(start[s], start[s + 1]):
            for p in range(column_pointer[j], column_pointer[j + 1]):
                i = column_index[p]
                if seen[i] != s:
                    seen[i] = s
                    rows[place] = i
                    place += 1
        child = first[s]
        while child != -1:
            for p in range(row_start[child], row_start[child + 1]):
                i = rows[p]
                if i >= start[s] and seen[i] != s:
                    seen[i] = s
                    rows[place] = i
                    place += 1
            child = following[child]
        if parent_of_node[s] != -1:
            following[s] = first[parent_of_node[s]]
            first[parent_of_node[s]] = s
    return rows


# Loops from zero over pieces of rows. The compiler makes vector code of them because it sees that no index counts from
# the end, and because the pieces are few enough for a check whether they overlap.


@inlined(nogil=True, fastmath=_FAST)
def _scale(factor, x):
    """x *= factor."""
    for j in range(x.size):
        x[j] *= factor


@inlined(nogil=True, fastmath=_FAST)
def _add(factor, x, y):
    """y += factor x."""
    for j in range(x.size):
        y[j] += factor * x[j]


@inlined(nogil=True, fastmath=_FAST)
def _add_four(a, w, b, x, c, y, d, z, out):
    """out -= a w + b x + c y + d z."""
    for j in range(out.size):
        out[j] -= a * w[j] + b * x[j] + c * y[j] + d * z[j]


@inlined(nogil=True)
def _subtract_rows(front, size, to, begin):
    """front[to, to:] -= the sum over the `_UNROLLED` rows k from `begin` on of front[k, to] front[k, to:]."""
    p, rest = begin * size + to, size - to
    q, r, s, row = p + size, p + 2 * size, p + 3 * size, to * size + to
    w, x, y, z = front[p : p + rest], front[q : q + rest], front[r : r + rest], front[s : s + rest]
    _add_four(w[0], w, x[0], x, y[0], y, z[0], z, front[row : row + rest])


@inlined(nogil=True)
def _eliminate(front, size, width):
    """Replace the first `width` rows of the symmetric front (size, size), given by its upper triangle, by rows of its
    factor L^T, and the rest by the contribution to the parent. False if a pivot is not positive."""
    for begin in range(0, width, _UNROLLED):
        end = min(begin + _UNROLLED, width)
        for j in range(begin, end):
            pivot = front[j * size + j]
            if not pivot > 0.0:
                return False
            row = front[j * size + j : (j + 1) * size]
            # 1 / sqrt in the precision of the front: a literal would be double.
            _scale(math.sqrt(pivot) / pivot, row)
            for k in range(j + 1, end):
                _add(-row[k - j], row[k - j :], front[k * size + k : (k + 1) * size])
        whole = end - begin == _UNROLLED
        for i in range(end, size):
            if whole:
                _subtract_rows(front, size, i, begin)
            else:
                for k in range(begin, end):
                    row = front[k * size + i : (k + 1) * size]
                    _add(-row[0], row, front[i * size + i : (i + 1) * size])
    return True


@njit(nogil=True)
def factorise(values, entry_start, place, start, row_start, parent, relative, panel_start, panels, work):
    """Fill `panels` with the columns of the factor: for supernode s as (rows, columns) from panel_start[s] on.

    values: entries of the lower triangle, of supernode s from entry_start[s] to entry_start[s + 1], each with its place
    in the front's array. work: scratch for contributions that wait for their parent. Returns the number of the first
    column whose pivot is not positive, or -1.
    """
    nodes = start.size - 1
    top, largest = 0, 0
    for s in range(nodes):
        largest = max(largest, row_start[s + 1] - row_start[s])
    scratch = np.empty(largest * largest, panels.dtype)
    begin_of = np.empty(nodes, np.int64)
    waiting, stack = 0, np.empty(nodes, np.int64)
    for s in range(nodes):
        size, width = row_start[s + 1] - row_start[s], start[s + 1] - start[s]
        front = scratch[: size * size]
        front[:] = 0.0
        for p in range(entry_start[s], entry_start[s + 1]):
            front[place[p]] += values[p]
        while waiting and parent[stack[waiting - 1]] == s:
            waiting -= 1
            child = stack[waiting]
            first = row_start[child] + start[child + 1] - start[child]
            count = row_start[child + 1] - first
            top = begin_of[child]
            for a in range(count):
                row, p = relative[first + a] * size, top + a * count
                for b in range(a, count):
                    front[row + relative[first + b]] += work[p + b]
        if not _eliminate(front, size, width):
            return start[s]
        out = panel_start[s]
        for i in range(size):
            for k in range(width):
                panels[out] = front[k * size + i]
                out += 1
        count = size - width
        if count:
            begin_of[s] = top
            for i in range(count):
                p = top + i * count
                row = (width + i) * size + width
                for k in range(i, count):
                    work[p + k] = front[row + k]
            top += count * count
            stack[waiting] = s
            waiting += 1
    return -1


@njit(nogil=True)
def largest_work(start, row_start, parent):
    """The largest size of the scratch `work` that `factorise` needs, as a count of numbers."""
    nodes = start.size - 1
    top, most, waiting = 0, 0, 0
    begin_of, stack = np.empty(nodes, np.int64), np.empty(nodes, np.int64)
    for s in range(nodes):
        while waiting and parent[stack[waiting - 1]] == s:
            waiting -= 1
            top = begin_of[stack[waiting]]
        count = row_start[s + 1] - row_start[s] - (start[s + 1] - start[s])
        if count:
            begin_of[s] = top
            top += count * count
            most = max(most, top)
            stack[waiting] = s
            waiting += 1
    return most


@njit(nogil=True, fastmath=_FAST)
def solve(start, rows, row_start, panel_start, panels, x):
    """Replace x (c, n) by the solutions of L L^T x = right, with the factor of `factorise`."""
    nodes, columns = start.size - 1, x.shape[0]
    for s in range(nodes):
        first, width = start[s], start[s + 1] - start[s]
        size = row_start[s + 1] - row_start[s]
        panel = panels[panel_start[s] : panel_start[s + 1]].reshape(size, width)
        for c in range(columns):
            own = x[c, first : first + width]
            for i in range(width):
                value = own[i]
                for k in range(i):
                    value -= panel[i, k] * own[k]
                own[i] = value / panel[i, i]
            for i in range(width, size):
                value = 0.0
                for k in range(width):
                    value += panel[i, k] * own[k]
                x[c, rows[row_start[s] + i]] -= value
    for s in range(nodes - 1, -1, -1):
        first, width = start[s], start[s + 1] - start[s]
        size = row_start[s + 1] - row_start[s]
        panel = panels[panel_start[s] : panel_start[s + 1]].reshape(size, width)
        for c in range(columns):
            own = x[c, first : first + width]
            for i in range(width, size):
                value = x[c, rows[row_start[s] + i]]
                for k in range(width):
                    own[k] -= panel[i, k] * value
            for i in range(width - 1, -1, -1):
                own[i] /= panel[i, i]
                value = own[i]
                for k in range(i):
                    own[k] -= panel[i, k] * value
