"""What recording costs: writer time and bytes a frame, and memory over a long run.

    python benchmarks/recording.py [--frames 1000] [--objects 60] [--profile]

Synthetic events (tests/recorded_run.py) of 320x240 images with noise and 60 objects, a third key frames.
The writer's time is that of its own thread; what the mission waits for is measured on a whole run.
"""

from __future__ import annotations

import argparse
import resource
import sys
import tempfile
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "tests"))

from recorded_run import SyntheticRun

from dssmsg.recording.repair import optimize
from dssmsg.recording.writer import RecordingWriter


def resident_megabytes() -> float:
    """Resident memory of this process now (Linux), else its peak."""
    status = Path("/proc/self/statm")
    if status.exists():
        return int(status.read_text().split()[1]) * resource.getpagesize() / 1e6
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e3


def main() -> None:
    """Run the benchmark and print a table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--frames", type=int, default=1000)
    parser.add_argument("--objects", type=int, default=60)
    parser.add_argument("--profile", action="store_true", help="print where the writer spends its time")
    options = parser.parse_args()
    run = SyntheticRun(options.frames, objects=options.objects, width=320, height=240, remember=False)
    profile = None
    if options.profile:
        import cProfile

        profile = cProfile.Profile()
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "run.rrd"
        writer = RecordingWriter(path, "benchmark")
        wall = cpu = 0.0
        memory: list[float] = []
        for number, event in enumerate(run.events()):
            wall_start, cpu_start = time.perf_counter(), time.thread_time()
            if profile:
                profile.enable()
            writer.write(event)
            if number % 120 == 119:  # about 25 frames: a second of the mission
                writer.flush()
            if profile:
                profile.disable()
            wall += time.perf_counter() - wall_start
            cpu += time.thread_time() - cpu_start
            if number % 120 == 119:
                memory.append(resident_megabytes())
        writer.close()
        raw = path.stat().st_size
        start = time.perf_counter()
        optimize(path)
        seconds = time.perf_counter() - start
        size = path.stat().st_size
    half = len(memory) // 2
    print(f"frames                     {options.frames}")
    per_frame = 1000 / options.frames
    print(f"writer, ms a frame         {wall * per_frame:.2f} ({cpu * per_frame:.2f} of its CPU)")
    kilobytes = 0.001 / options.frames
    print(f"file, kB a frame           {size * kilobytes:.1f} ({raw * kilobytes:.1f} while written)")
    print(f"optimizing                 {seconds:.2f} s")
    print(f"memory, MB                 half way {memory[half]:.0f}, end {memory[-1]:.0f}")
    if profile:
        profile.print_stats("tottime")


if __name__ == "__main__":
    main()
