"""Views of lattice poses entry by entry of the fan, from the log-odds themselves."""

import numpy as np

from coopmap_env.information.entropy import entropy_terms


def visible_entries(map_, fan, pose_id):
    """Entries of the fan, and flat cells, that a pose sees, nearest first."""
    nx, ny = map_.grid.shape
    cell, heading = divmod(int(pose_id), fan.n_headings)
    x, y = divmod(cell, ny)
    alive = fan.all_beams.copy()
    found = []
    for k in range(fan.start[heading], fan.start[heading + 1]):
        i, j = x + int(fan.offsets[k, 0]), y + int(fan.offsets[k, 1])
        if not (0 <= i < nx and 0 <= j < ny and (alive & fan.beams[:, k]).any()):
            continue
        at = i * ny + j
        found.append((k, at))
        if map_.sampled_mask[at] and map_.log_odds_fixed[at] >= 0:
            alive &= ~fan.beams[:, k]
    return found


def new_information(map_, rating, pose_id, reserved_mask):
    """NI, summed in the order of the bins, and how many never-sampled cells it sees."""
    gray, n = rating.gray, rating.fan.max_visible_cells
    counts, unknown = [0] * gray.n_bins, 0
    for k, at in visible_entries(map_, rating.fan, pose_id):
        if reserved_mask[at]:
            continue
        if map_.sampled_mask[at]:
            column = map_.log_odds_fixed[at] + map_.log_odds_range.clamp
            counts[gray.sampled[gray.distance_class[k], column]] += 1
        else:
            counts[gray.unknown[k]] += 1
            unknown += 1
    if gray.hidden_is_empty:
        counts[0] = n - sum(counts[1:])
    terms, h = entropy_terms(n), 0.0
    for count in counts:
        h += float(terms[count])
    return h, unknown


def sequential_new_information(map_, rating, pose_ids):
    """NI of each pose without what the poses before it see."""
    reserved_mask, values = np.zeros(map_.grid.n_cells, dtype=np.uint8), []
    for pose_id in pose_ids:
        values.append(new_information(map_, rating, pose_id, reserved_mask)[0])
        reserved_mask[[at for _, at in visible_entries(map_, rating.fan, pose_id)]] = 1
    return values
