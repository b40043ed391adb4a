"""A robot's loop for hours, in minutes: does memory stay flat, and does no frame take too long?

python -m tests.corpus.soak --frames 10000 --config default

Small frames of rooms that are met one after the other, and again and again later on; things in
them come and go. Capacities grow several times in the first part, or objects come to rest. How long
a frame takes is the lesser of two times, as neither is less than that: what this process computes
meanwhile, with the device and what is prepared in the background; and the time on the wall without
what its thread waited for a processor.
"""

import argparse
import dataclasses
import functools
import resource
import sys
import time
from collections.abc import Iterator, Sequence
from pathlib import Path

import cv2
import numpy as np
from scipy.stats import theilslopes

import remind_jax as rj

HEIGHT_PX, WIDTH_PX = 128, 160
TILE_PX = 36
PLACES = ((10, 12), (10, 100), (76, 14), (80, 98))  # top, left of the things of a room
NUM_ROOMS = 40
NUM_CLASSES = 24
VISIT = 20  # frames in a room
# The tour: every room is met as often as there are pictures of an object to be kept.
TOUR_VISIT = 8  # frames in a room
TOUR = 3 * NUM_ROOMS * TOUR_VISIT  # frames
CROWD = 24  # things in a frame now and then, more than there is room for at first
FIRST_OBJECTS = 32  # that there is room for
FIRST = 1000  # frames in which memory may grow; not fewer than the tour has
WARM_UP = 100  # frames that may take longer
MOST_TIMES = 10.0  # the median, of any frame after the warm-up
MOST_KIB_PER_1000 = 256.0  # that memory may grow by in 1,000 frames after the first ones,
FEWEST_PARTS = 5  # if there are so many thousands; in fewer, what comes and goes looks like a slope
MOST_GROWTH = 0.01  # of it in all, from the first of these thousands to the last


@dataclasses.dataclass(frozen=True)
class Figures:
    """What a soak found."""

    num_objects: int
    median_ms: float  # of a frame after the warm-up
    worst_ms: float
    worst_frame: int
    grown_at: tuple[int, ...]
    num_at_rest: int  # objects that came to rest instead
    rss_mib: tuple[float, ...]  # the median of each 1,000 frames, the first ones left out
    kib_per_1000: float  # `slope_of` these

    @property
    def failures(self) -> list[str]:
        """What is out of bounds."""
        found = []
        if self.worst_ms > MOST_TIMES * self.median_ms:
            found.append(
                f"frame {self.worst_frame} took {self.worst_ms:.1f} ms, the median is "
                f"{self.median_ms:.2f} ms"
            )
        if self.kib_per_1000 > MOST_KIB_PER_1000 and len(self.rss_mib) >= FEWEST_PARTS:
            found.append(f"memory grows by {self.kib_per_1000:.0f} KiB in 1,000 frames")
        if self.rss_mib and self.rss_mib[-1] > (1 + MOST_GROWTH) * self.rss_mib[0]:
            found.append(f"memory grew from {self.rss_mib[0]:.1f} to {self.rss_mib[-1]:.1f} MiB")
        if not self.grown_at and not self.num_at_rest:
            found.append("memory never was full, so that nothing is known of frames in which it is")
        return found


@functools.cache
def _tile(thing: int) -> np.ndarray:
    texture = np.random.default_rng(thing).integers(0, 255, (5, 5, 3), np.uint8)
    return cv2.resize(texture, (TILE_PX, TILE_PX), interpolation=cv2.INTER_CUBIC)


@functools.cache
def _background(room: int) -> np.ndarray:
    coarse = np.random.default_rng(100_000 + room).integers(60, 190, (4, 5, 3), np.uint8)
    return cv2.resize(coarse, (WIDTH_PX, HEIGHT_PX), interpolation=cv2.INTER_CUBIC)


def picture(index: int) -> tuple[np.ndarray, rj.Detections]:
    """Frame number `index`; nothing but crumbs is new after the tour."""
    is_tour = index < TOUR
    visit, at = divmod(index, TOUR_VISIT) if is_tour else divmod(index - TOUR, VISIT)
    rng = np.random.default_rng(visit)
    room = visit % NUM_ROOMS if is_tour else int(rng.integers(NUM_ROOMS))
    present = [place for place in range(len(PLACES)) if is_tour or rng.random() < 0.8]
    image = _background(room).copy()
    masks, labels = [], []
    for place in present:
        thing = len(PLACES) * room + place
        top, left = PLACES[place][0] + at % 5, PLACES[place][1] + (at // 2) % 7
        window = np.s_[top : top + TILE_PX, left : left + TILE_PX]
        image[window] = _tile(thing)
        mask = np.zeros((HEIGHT_PX, WIDTH_PX), bool)
        mask[window] = True
        masks.append(mask)
        labels.append(f"class {thing % NUM_CLASSES}")
    if index % 320 == 250:  # crumbs everywhere, for a frame
        for number in range(CROWD - len(masks)):
            mask = np.zeros((HEIGHT_PX, WIDTH_PX), bool)
            row, column = divmod(number, 8)
            mask[44 + 10 * row : 52 + 10 * row, 4 + 19 * column : 20 + 19 * column] = True
            masks.append(mask)
            labels.append("crumb")
    planes = np.array(masks, bool).reshape(-1, HEIGHT_PX, WIDTH_PX)
    noise = np.random.default_rng(index).integers(0, 6, image.shape, np.uint8)
    return cv2.add(image, noise), rj.Detections.create(planes, labels)


def soak(num_frames: int, config: str) -> Iterator[str | Figures]:
    """Tracks so many frames; tells how far it is, and in the end what was found."""
    # Fewer than at first otherwise, so that trackers grow that tell few of the things apart, too.
    tracker = rj.Tracker({"base": config, "static": {"num_objects": FIRST_OBJECTS}})
    tracker.warm_up((HEIGHT_PX, WIDTH_PX), num_objects=4 * NUM_ROOMS, num_detections=CROWD)
    spent_ms, grown_at = np.zeros(num_frames), []
    frames, rss = [], []
    for index in range(num_frames):
        image, detections = picture(index)
        start, computed, delayed = time.perf_counter(), time.process_time(), _delay_s()
        tracks = tracker.update(image, detections)
        _ = [tracks.display_name(row) for row in range(len(tracks))]
        own_s = time.perf_counter() - start - (_delay_s() - delayed)
        spent_ms[index] = 1000 * min(time.process_time() - computed, own_s)
        if tracker.has_grown:
            grown_at.append(index)
        if index % 50 == 0:
            frames.append(index)
            rss.append(_rss_mib())
        if index and index % 1000 == 0:
            yield f"{index} frames, {tracker.num_objects} objects, {rss[-1]:.1f} MiB"
    # What was freed goes back to the system every 1,000 frames, and a sample now and then sees two
    # copies of the memory, before the former one is let go of.
    num_parts = (num_frames - FIRST) // 1000
    part_of, mib = (np.array(frames) - FIRST) // 1000, np.array(rss)
    usual = tuple(float(np.median(mib[part_of == part])) for part in range(num_parts))
    worst = WARM_UP + int(np.argmax(spent_ms[WARM_UP:]))
    yield Figures(
        num_objects=tracker.num_objects,
        median_ms=float(np.median(spent_ms[WARM_UP:])),
        worst_ms=float(spent_ms[worst]),
        worst_frame=worst,
        grown_at=tuple(grown_at),
        num_at_rest=tracker.memory_use.at_rest,
        rss_mib=usual,
        kib_per_1000=slope_of(usual) * 1024,
    )


def slope_of(values: Sequence[float]) -> float:
    """The median of the slopes between any two: what lasts counts, what comes and goes does not."""
    return float(theilslopes(values)[0]) if len(values) > 1 else 0.0


def _delay_s() -> float:
    """Seconds that this thread could have run and no processor was free; 0 where nobody counts."""
    try:
        return int(Path("/proc/thread-self/schedstat").read_text().split()[1]) / 1e9
    except OSError:
        return 0.0


def _rss_mib() -> float:
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * resource.getpagesize() / 2**20


def main() -> int:
    """Exit status 1 if a figure is out of bounds."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--frames", type=int, default=10_000)
    parser.add_argument("--config", default="default")
    options = parser.parse_args()
    for told in soak(options.frames, options.config):
        print(told, flush=True)
        if isinstance(told, Figures):
            failures = told.failures
    print("\n".join(failures) or "all within bounds")
    return int(bool(failures))


if __name__ == "__main__":
    sys.exit(main())
