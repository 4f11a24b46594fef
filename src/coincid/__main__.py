# SPDX-License-Identifier: Apache-2.0
"""The program `coincid`, and `python -m coincid`: signals, and errors of the operating system.

Signals are handled before the command line and its libraries are imported, which takes half a
second. Once a command has ended, its exit code stands, and signals change nothing.
"""

import errno
import os
import signal
import sys
from typing import TextIO

BAD_INPUT = 2
READER_GONE = 128 + signal.SIGPIPE  # as of a program that the signal ends
SIGNALS = signal.SIGINT, signal.SIGTERM
STDERR = 2  # number of the last of the standard files
SIZES = "COLUMNS", "LINES"  # of a terminal, in the environment
EPOCH = "SOURCE_DATE_EPOCH"  # of builds, in the environment
SIZE_MAX = 999  # tables fill wider terminals with spaces, if need be gigabytes


def main() -> None:
    """Entry point of the console script."""
    _replace_closed_files()
    # A shell starts what runs in the background with SIGINT ignored.
    signal.signal(signal.SIGINT, signal.default_int_handler)
    code = _run()
    for number in SIGNALS:
        signal.signal(number, signal.SIG_IGN)
    sys.exit(code)


def _run() -> int | str | None:
    """Run the command that was typed, and return its exit code."""
    try:
        code = _command()
        sys.stdout.flush()
    except KeyboardInterrupt as why:
        from coincid.model.shared.interrupts import exit_code

        _tell("interrupted")
        _forget_interrupt()
        return exit_code(why)
    except BrokenPipeError:  # who read the output has enough
        _forget(sys.stdout)
        return READER_GONE
    except OSError as error:
        _forget(sys.stdout)
        _tell(_told(error))
        return BAD_INPUT
    except MemoryError as error:
        _tell(f"not enough memory. {error}".strip(" ."))
        return BAD_INPUT
    except ImportError as error:
        if isinstance(error, ModuleNotFoundError):  # our own mistake
            raise
        _tell(_first_cause(error))
        return BAD_INPUT
    return code


def _tell(message: str) -> None:
    """Print the one line that says why the program ends, if the standard error takes it."""
    try:
        print(f"coincid: {message}", file=sys.stderr, flush=True)
    except OSError:
        _forget(sys.stderr)


def _first_cause(error: BaseException) -> str:
    """Return the first line of the error that all others follow from, such as a library that finds
    no memory.
    """
    while error.__cause__ or error.__context__:
        error = error.__cause__ or error.__context__ or error
    return str(error).strip().partition("\n")[0]


def _command() -> int | str | None:
    from coincid.model.shared.interrupts import interruptible

    # Pictures are files; the surroundings may name a way to windows that is not there.
    os.environ["MPLBACKEND"] = "agg"
    _bound_terminal()
    _forget_bad_epoch()
    interruptible()
    from coincid.cli import app

    try:
        app()
    except SystemExit as ended:
        # Typer ends with code 1, which stands for something else here
        return READER_GONE if isinstance(ended.__context__, BrokenPipeError) else ended.code
    return None


def _bound_terminal() -> None:
    """Replace sizes of the terminal that are too large, or no numbers that Python reads. Remove those
    of 0, which mean that nobody knows them; Rich would print nothing.
    """
    for name in SIZES:
        told = os.environ.get(name, "")
        if len(told) > len(str(SIZE_MAX)) or not told.isascii():
            os.environ[name] = str(SIZE_MAX)
        elif told and not told.strip("0"):
            del os.environ[name]


def _forget_bad_epoch() -> None:
    """Remove a time of the build that is no number, which libraries read while they are imported."""
    told = os.environ.get(EPOCH, "0")
    if not (told.isascii() and told.isdecimal()):
        del os.environ[EPOCH]


def _replace_closed_files() -> None:
    """Discard what is written to a standard output or error that is closed. No file that the
    program opens gets its number, so no output of another program ends up in it.
    """
    number = os.open(os.devnull, os.O_RDWR)
    while number <= STDERR:
        number = os.open(os.devnull, os.O_RDWR)
    os.close(number)
    sys.stdout = sys.stdout or open(os.devnull, "w", encoding="utf-8")
    sys.stderr = sys.stderr or open(os.devnull, "w", encoding="utf-8")


def _told(error: OSError) -> str:
    """Return what the operating system refused, in one line."""
    place = "standard output" if error.filename is None else str(error.filename)
    if error.filename is None and error.errno == errno.ENOENT:
        place = "the current folder"
    return f"{place}: {error.strerror}" if error.strerror else str(error)


def _forget_interrupt() -> None:
    """Let Python end with the exit code of the program.

    It notes an interrupt in code that comes as text, such as that of a named tuple, as one that
    nobody handles, and would end by the signal. Other code that comes as text deletes the note.
    """
    eval("None")


def _forget(output: TextIO) -> None:
    """Discard what is left for a standard file that takes no more, so that the end of the program
    does not try again, and its exit code stands.
    """
    nowhere = os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, output.fileno())
    os.close(nowhere)


if __name__ == "__main__":
    main()
