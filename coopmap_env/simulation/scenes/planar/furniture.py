"""Furniture: pieces are tried one after the other, and those that fit are placed."""

from numba import njit


@njit(cache=True, nogil=True)
def place_furniture(occupied, reserved, pieces, aisle):
    """Occupy each piece that meets no cell kept free, and keep an aisle around it free.

    Parameters
    ----------
    occupied, reserved : (nx, ny) bool arrays
        Changed in place.
    pieces : (k, 4) int array
        Rectangles [x, y, n_x, n_y] of cells, inside the world.
    aisle : int
        Cells around a piece that no later one may take.
    """
    for k in range(len(pieces)):
        x, y = pieces[k, 0], pieces[k, 1]
        end_x, end_y = x + pieces[k, 2], y + pieces[k, 3]
        if reserved[x:end_x, y:end_y].any():
            continue
        occupied[x:end_x, y:end_y] = True
        reserved[max(x - aisle, 0) : end_x + aisle, max(y - aisle, 0) : end_y + aisle] = True
