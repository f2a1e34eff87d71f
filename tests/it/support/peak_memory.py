"""Runs a command and prints its peak of memory in KiB: peak_memory.py COMMAND..."""
import os, sys

child = os.posix_spawn(sys.argv[1], sys.argv[1:], os.environ, file_actions=[
    (os.POSIX_SPAWN_OPEN, 1, "/dev/null", os.O_WRONLY, 0)])
_, status, usage = os.wait4(child, 0)
assert os.waitstatus_to_exitcode(status) == 0, status
print(usage.ru_maxrss)
