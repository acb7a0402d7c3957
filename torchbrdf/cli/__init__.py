"""The command line, `torchbrdf run | fit | ...`. A command is a file here: `add` to the parser, and `command`."""

import atexit
import os
import signal
import sys
from collections.abc import Sequence

from torchbrdf.cli.signals import EndedError, ending


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a command; the exit status is 0, 1 (data or a run failed), 2 (usage), or 128 and the number of a signal."""
    try:
        with ending(None):
            # Here, so that a signal before the commands are imported ends it well, too.
            from torchbrdf.cli.commands import build_parser, make_streams_safe, perform

            make_streams_safe()
            return perform(build_parser().parse_args(arguments))
    except EndedError as error:
        signal.signal(signal.SIGINT, signal.SIG_DFL)  # another ends it at once, as the others do
        print("torchbrdf: stopped", file=sys.stderr)
        sys.stdout.flush()
        # All is closed but what libraries registered; to take torch apart takes seconds on a busy machine.
        atexit._run_exitfuncs()
        os._exit(128 + error.number)
    except KeyboardInterrupt:  # of a caller, who is no signal
        print("torchbrdf: stopped", file=sys.stderr)
        return 128 + signal.SIGINT
