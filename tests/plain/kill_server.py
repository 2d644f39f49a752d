"""Plays small commands, each in a process of its own that kills itself at a chosen file event.

An event is an access to a file in the command's folder: it is opened, renamed or removed, or a
folder is made. Events are counted, so that a kill does not depend on time. The server imports
everything and loads the kernels once and forks, so that a command starts within milliseconds.

A request is a line of JSON, {"command": ..., "out": ..., "event": ...}; event 0 never comes. The
answer has the exit status (negative: a signal), the number of events, and whether the command or a
process that it started was still there a minute later.
"""

import importlib
import json
import os
import select
import signal
import sys
import traceback
from functools import cache

from plain import golden

GUARD_SECONDS = 60
EVENTS = ("open", "os.rename", "os.remove", "os.mkdir")
TRAINING = ("coopmap_agents.training", "torch.utils.tensorboard", "torch._dynamo")
IMPORTED_LATE = {
    "localization": ("trimesh", "embreex", "PIL.Image"),
    "train": TRAINING,
    "train with sb3": TRAINING,
}
"""Modules that take seconds to import, and which commands import when they need them."""
FIELD = ("localization",)
"""Commands that play in the field."""


def main():
    answers = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)  # PyBullet prints when it is imported
    from plain import small_commands

    for line in sys.stdin:
        print(json.dumps(serve(json.loads(line), small_commands)), file=answers, flush=True)


def serve(request, commands):
    for module in IMPORTED_LATE.get(request["command"], ()):
        importlib.import_module(module)
    load_kernels("coopmap/FieldSearch-v1" if request["command"] in FIELD else "coopmap/Planar-v1")
    alive, its_end = os.pipe()
    process = os.fork()
    if process == 0:
        os.close(alive)
        os._exit(play(request, commands, its_end))
    os.close(its_end)
    _, status = os.waitpid(process, 0)
    # its standard output is open until the last process that inherited it has ended
    counted = b""
    while select.select([alive], [], [], GUARD_SECONDS)[0]:
        part = os.read(alive, 4096)
        if not part:
            break
        counted += part
    else:
        return {"status": "a process is left behind"}
    os.close(alive)
    return {"status": os.waitstatus_to_exitcode(status), "events": len(counted)}


@cache
def load_kernels(env_id):
    """Play an episode with random actions and one with a planner."""
    golden.trajectory_hashes(env_id, "candidates", 1)
    golden.planner_hashes(env_id, "rating_function", 1)


def play(request, commands, its_end):
    os.setsid()  # what it starts does not end with us
    os.dup2(os.open(os.devnull, os.O_RDONLY), 0)
    os.dup2(its_end, 1)
    log = os.open(f"{request['out']}.log", os.O_WRONLY | os.O_CREAT | os.O_APPEND)
    os.dup2(log, 2)
    sys.stdout = sys.stderr
    count_events(request["out"], request["event"])
    try:
        commands.COMMANDS[request["command"]](request["out"])
    except BaseException:
        traceback.print_exc()
        return 1
    return 0


def count_events(folder, last):
    count = 0

    def count_event(event, arguments):
        nonlocal count
        if event not in EVENTS or not isinstance(arguments[0], str | os.PathLike):
            return
        if os.fspath(arguments[0]).startswith(folder + os.sep):
            count += 1
            os.write(1, b".")
            if count == last:
                os.kill(os.getpid(), signal.SIGKILL)

    sys.addaudithook(count_event)


if __name__ == "__main__":
    main()
