"""States of trajectories in plain Python: what the compiled interpolation must give."""


def segment(times, stamp, max_gap, max_ahead):
    """(left, right, share) as `segment_at` of the kernels defines it; (-1, -1, 0) where there is no state."""
    nowhere = -1, -1, 0.0
    if not times or stamp < times[0]:
        return nowhere
    if stamp in times:
        index = times.index(stamp)
        return index, index, 0.0
    last = len(times) - 1
    if stamp > times[last]:
        if stamp > times[last] + max_ahead:
            return nowhere
        if last == 0 or times[last] - times[last - 1] > max_gap:
            return last, last, 0.0
        left = last - 1
    else:
        left = max(k for k in range(last) if times[k] < stamp)
        if times[left + 1] - times[left] > max_gap:
            return nowhere
    return left, left + 1, (stamp - times[left]) / (times[left + 1] - times[left])
