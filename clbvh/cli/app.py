"""The command `clbvh`: joins the verbs, and turns exceptions into one line and an exit code."""

from __future__ import annotations

import os
import sys
import traceback
import warnings
from typing import Annotated, Any

import typer

from ..errors import ClbvhError, ClbvhWarning, DeviceError
from . import devices, doctor, fetch, images, render, sheet, stats, study, tune, turntable, warmup

EXIT_FAILED = 1
EXIT_USAGE = 2
EXIT_NO_DEVICE = 3

app = typer.Typer(
    name="clbvh",
    help="Cast rays at triangle meshes: a parallel BVH build on the host, OpenCL traversal on any device.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)
app.command(name="render")(render.render)
app.command(name="images")(images.images)
app.command(name="turntable")(turntable.turntable)
app.command(name="sheet")(sheet.sheet)
app.command(name="stats")(stats.stats)
app.command(name="fetch")(fetch.fetch)
app.command(name="devices")(devices.devices)
app.command(name="doctor")(doctor.doctor)
app.command(name="tune")(tune.tune)
app.command(name="study")(study.study)
app.command(name="warmup")(warmup.warmup)


def _print_version(wanted: bool) -> None:
    if wanted:
        from ..support.folders import __version__

        print(f"clbvh {__version__}")
        raise typer.Exit


@app.callback()
def _options(
    context: typer.Context,
    debug: Annotated[bool, typer.Option("--debug", help="Show the traceback of an error.")] = False,
    version: Annotated[
        bool, typer.Option("--version", help="Print the version.", callback=_print_version, is_eager=True)
    ] = False,
) -> None:
    context.obj = {"debug": debug}


def exit_code_of(error: BaseException) -> int:
    """Return the exit code for an exception: 2 for bad input, 3 for no usable device, 1 for any other failure."""
    if isinstance(error, DeviceError):
        return EXIT_NO_DEVICE
    if isinstance(error, ClbvhError) and isinstance(error, ValueError):
        return EXIT_USAGE
    return EXIT_FAILED


def run(arguments: list[str] | None = None) -> None:
    """Run one command and end the process with its exit code.

    Parameters
    ----------
    arguments : list of str, optional
        The words behind `clbvh`; those of `sys.argv` without it.
    """
    words = sys.argv[1:] if arguments is None else arguments
    # `--debug` is allowed anywhere: users add it to the end of the command that failed.
    debug = "--debug" in words
    words = [word for word in words if word != "--debug"]
    code: Any = EXIT_FAILED
    try:
        try:
            with warnings.catch_warnings():
                warnings.showwarning = _show_warning
                warnings.simplefilter("always", ClbvhWarning)
                app(words)
        except SystemExit as ended:
            code = ended.code
        print(end="", flush=True)
    except BrokenPipeError:
        # The reader has had enough, as `head` has: nobody is left to tell.
        code = code or EXIT_FAILED
    except (ClbvhError, OSError, MemoryError, ImportError) as error:
        if debug:
            traceback.print_exc()
        print(f"clbvh: {_describe(error)}", file=sys.stderr)
        code = exit_code_of(error)
    _drop_unwritten()
    sys.exit(code)


def _drop_unwritten() -> None:
    """Keep Python from trying once more, at its end, to write what could not be written."""
    try:
        print(end="", flush=True)
    except OSError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def _show_warning(message: Warning | str, category: type[Warning], *place: Any, **more: Any) -> None:
    """Print a warning as one line, without the line of a program that the user has not made."""
    name = "" if issubclass(category, ClbvhWarning) else f"{category.__name__}: "
    print(f"clbvh: warning: {name}{message}", file=sys.stderr)


def _describe(error: Exception) -> str:
    """Return one sentence about an error."""
    if isinstance(error, MemoryError):
        return f"there is not enough memory{f': {error}' if str(error) else ''}"
    if isinstance(error, OSError) and error.strerror and not isinstance(error, ClbvhError):
        return f"{error.filename}: {error.strerror}" if error.filename else error.strerror
    return str(error)
