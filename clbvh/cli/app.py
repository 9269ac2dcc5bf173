"""The command `clbvh`: finds the verb, and turns exceptions into one line and an exit code."""

from __future__ import annotations

import os
import sys
import traceback
import warnings
from typing import Any

from cyclopts import App, CycloptsError, Group, Parameter, UnusedCliTokensError

from ..errors import ClbvhError, ClbvhWarning, DeviceError

EXIT_FAILED = 1
EXIT_USAGE = 2
EXIT_NO_DEVICE = 3
HELP_FLAGS = "--help", "-h"

# Each is a function in a module of its name, which is imported when the verb is needed. Its arguments and its line of
# the help stand here, so that the list of verbs imports none of them, and options are collected once for a help.
VERBS = {
    "render": ("MESH|SCENE... -o FILE", "Render meshes or a scene."),
    "view": ("MESH|SCENE...", "Look at meshes or a scene in the browser: orbit, pan, zoom, fly, cut, measure."),
    "images": (
        "MESH|SCENE... -o FILE",
        "Write what each pixel sees: depth, normals, positions, ids, texture coordinates, motion.",
    ),
    "turntable": ("MESH|SCENE... -o FILE", "Write an animation in which meshes or a scene turn once around."),
    "sheet": ("MESH|SCENE... -o FILE", "Write the standard views of meshes or a scene, at one scale, as one picture."),
    "stats": ("MESH|SCENE", "Build a tree and measure it."),
    "shard": ("MESH -o FOLDER", "Cut a mesh into shards, of which clbvh.ShardedTracer has one at a time in memory."),
    "fetch": (
        "[NAME...]",
        "Download known meshes into the cache unless they are on this machine; without a name, list them.",
    ),
    "devices": ("", "List the devices, the host first, with a mark on the default one."),
    "doctor": ("", "Check the host device, and OpenCL from the loader to kernels; print faults and remedies."),
    "study": (
        "[EXPERIMENT...]",
        "Repeat the report's experiments on this machine, and write one page with all figures.",
    ),
    "warmup": ("", "Compile the kernels of OpenCL devices ahead, by doing each kind of work once; for images, too."),
}


def make_app() -> App:
    """Return the command line, with all verbs."""
    app = App(
        name="clbvh",
        help="Cast rays at triangle meshes: a parallel BVH build on the host, OpenCL traversal on any device.",
        help_epilogue="With --debug, anywhere, an error shows its traceback.",
        help_flags=HELP_FLAGS,
        help_format="plaintext",  # Markdown would take 0.04 s of every help
        version=_make_version,
        group_commands=Group("Commands", sort_key=0),
        group_arguments=Group("Arguments", sort_key=1),
        group_parameters=Group("Options", sort_key=2),
        # A flag has no other form unless it names one, and of an option that is given twice the last one counts.
        default_parameter=Parameter(negative=(), allow_repeating=True, show_default=False),
        result_action="return_value",
        exit_on_error=False,
        print_error=False,
        suppress_keyboard_interrupt=False,
    )
    for verb, (arguments, line) in VERBS.items():
        usage = " ".join(f"Usage: clbvh {verb} {arguments} [OPTIONS]".split())
        app.command(f"{__package__}.{verb}:{verb}", name=verb, help=line, usage=usage)
    return app


def _make_version() -> str:
    from ..support.version import __version__

    return f"clbvh {__version__}"


def exit_code_of(error: BaseException) -> int:
    """Return the exit code for an exception: 2 for bad input, 3 for no usable device, 1 for any other failure."""
    if isinstance(error, DeviceError):
        return EXIT_NO_DEVICE
    if isinstance(error, CycloptsError) or (isinstance(error, ClbvhError) and isinstance(error, ValueError)):
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
    code = EXIT_FAILED
    try:
        with warnings.catch_warnings():
            warnings.showwarning = _show_warning
            warnings.simplefilter("always", ClbvhWarning)
            *verb, last = words or [""]
            if last in HELP_FLAGS and len(verb) < 2 and VERBS.keys() >= {*verb}:
                make_app().help_print(verb)  # as the call does, which collects all options once more before
            else:
                make_app()(words)
        print(end="", flush=True)
        code = 0 if words else EXIT_USAGE
    except BrokenPipeError:
        # The reader has had enough, as `head` has: nobody is left to tell.
        pass
    except (ClbvhError, CycloptsError, OSError, MemoryError, ImportError) as error:
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
    if isinstance(error, UnusedCliTokensError):
        return f"unexpected argument '{' '.join(error.unused_tokens or ())}'"
    if isinstance(error, CycloptsError):
        text = " ".join(str(error).split()).removesuffix(".")
        return text[:1].lower() + text[1:]
    if isinstance(error, OSError) and error.strerror and not isinstance(error, ClbvhError):
        return f"{error.filename}: {error.strerror}" if error.filename else error.strerror
    return str(error)
