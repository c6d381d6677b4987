"""Which modules of a package cannot be imported first.

A process that imports each module anew would take a minute. Instead, each import happens in a fork
of a process that holds other modules with imports that are tested and never reach the module:
they cannot take part in a cycle with it. A fork therefore ends at the first import that brings
modules that are not tested yet, and this process imports only what brings none.
"""

import os
import sys
from importlib import import_module
from pathlib import Path


def modules_of(package):
    root = Path(import_module(package).__file__).parent
    names = (
        ".".join(file.relative_to(root.parent).with_suffix("").parts)
        for file in sorted(root.rglob("*.py"))
        if file.stem != "__main__"
    )
    return [name.removesuffix(".__init__") for name in names]


def loaded(package):
    return [name for name in sys.modules if name.split(".")[0] == package]


def lines_of_fork(function, *arguments):
    """Return the lines that a function yields in a fork of this process."""
    reading, writing = os.pipe()
    if os.fork() == 0:
        os.close(reading)
        with os.fdopen(writing, "w", encoding="utf-8") as file:
            file.writelines(f"{line}\n" for line in function(*arguments))
        os._exit(0)
    os.close(writing)
    with os.fdopen(reading, encoding="utf-8") as file:
        lines = file.read().splitlines()
    os.wait()
    return lines


def import_until_more(package, names, tested):
    """Yield the message of each import; the last is an error or brought untested modules."""
    for number, name in enumerate(names, start=1):
        try:
            import_module(name)
        except Exception as error:
            yield f"{name}: {error}"
            return
        yield ""
        if not tested.union(names[:number]).issuperset(loaded(package)):
            return


def in_order_of_completion(package):
    """Yield modules after those that they import, as far as these form no cycle."""
    for name in modules_of(package):
        try:
            import_module(name)
        except Exception:
            yield name
    yield from loaded(package)


def refused(package):
    """Return the messages of the modules that cannot be imported first."""
    waiting = list(dict.fromkeys(lines_of_fork(in_order_of_completion, package)))
    tested, failed = set(loaded(package)), []
    while waiting:
        messages = lines_of_fork(import_until_more, package, waiting, tested)
        for name in waiting[: len(messages) - 1]:
            import_module(name)
        tested.update(waiting[: len(messages)])
        failed += [message for message in messages if message]
        waiting = waiting[len(messages) :]
    return failed
