import subprocess
import sys

import pytest

from coopmap_env.core.quiet import native_stderr_muted


def test_what_libraries_print_is_dropped_and_the_stream_is_restored(capfd):
    import os

    with native_stderr_muted():
        os.write(2, b"noise")
    os.write(2, b"printed")
    assert capfd.readouterr().err == "printed"


def test_errors_pass():
    with pytest.raises(ImportError, match="broken"), native_stderr_muted():
        raise ImportError("broken")


def test_a_process_without_the_stream_goes_on():
    code = (
        "import os; os.close(2)\n"
        "from coopmap_env.core.quiet import native_stderr_muted\n"
        "with native_stderr_muted(): print('fine')"
    )
    done = subprocess.run([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True)
    assert done.stdout == "fine\n"
