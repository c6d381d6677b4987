"""Start the command line again and again from one warm process; ``test_killed.py`` runs it.

Reads a line ``[folder, argument, ...]`` for each command and forks a process for it, with a group
of its own. Answers with its number and, when it has ended, with its status; it writes to ``output``
in the folder. Nothing but the start of worker processes, forked here too, differs from the command.
"""

import json
import multiprocessing
import os
import sys
from pathlib import Path

from multiscale.cli import main


def run(folder, arguments):
    """Be the command."""
    os.setpgid(0, 0)
    os.chdir(folder)
    output = os.open("output", os.O_WRONLY | os.O_CREAT | os.O_APPEND)
    os.dup2(output, 1)
    os.dup2(output, 2)
    status = 1
    try:
        call(arguments)
    except SystemExit as end:
        status = end.code or 0
    except BaseException:
        sys.excepthook(*sys.exc_info())
    finally:
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(status)


def call(arguments):
    """Call the command in this process."""
    sys.argv = ["multiscale", *arguments]
    main()


def serve():
    """Warm up with the first command, then fork one for each line."""
    answers = os.fdopen(os.dup(1), "w")
    fork = multiprocessing.get_context("fork")
    multiprocessing.get_context = lambda method=None: fork
    for number, line in enumerate(sys.stdin):
        folder, *arguments = json.loads(line)
        Path(folder).mkdir(exist_ok=True)
        if number == 0:
            os.chdir(folder)
            os.dup2(os.open("output", os.O_WRONLY | os.O_CREAT), 1)
            try:
                call(arguments)
            except SystemExit as end:
                print(end.code or 0, file=answers, flush=True)
            continue
        child = os.fork()
        if child == 0:
            run(folder, arguments)
        print(child, file=answers, flush=True)
        print(os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]), file=answers, flush=True)


if __name__ == "__main__":
    serve()
