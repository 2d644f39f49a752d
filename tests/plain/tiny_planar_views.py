"""What a planar camera views, slowly: beam by beam from the bits of the fan."""


def plain_view(views, pose):
    """The cells in view of a pose of `PlanarViews`."""
    nx, ny = views.occupied.shape
    fan, (cell, heading) = views.fan, divmod(int(pose), views.n_headings)
    ended, seen = [0] * len(fan.all_beams), set()
    for k in range(fan.start[heading], fan.start[heading + 1]):
        i, j = cell // ny + int(fan.offsets[k, 0]), cell % ny + int(fan.offsets[k, 1])
        if 0 <= i < nx and 0 <= j < ny:
            alive = [int(word) & ~gone for word, gone in zip(fan.beams[:, k], ended, strict=True)]
            if any(alive):
                seen.add(i * ny + j)
            if views.occupied[i, j]:
                ended = [gone | one for gone, one in zip(ended, alive, strict=True)]
    return seen
