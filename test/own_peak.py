"""The largest memory of a process, for scripts that tests run in one of their own."""

PEAK = """
def peak():
    # The rusage of a process begins with the peak of the one that started it; this is its own.
    with open("/proc/self/status") as status:
        return 1024 * int(next(line for line in status if line.startswith("VmHWM")).split()[1])
"""
"""Source of a function that returns it, bytes: put before the script."""
