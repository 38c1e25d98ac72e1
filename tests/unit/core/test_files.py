"""Where a command may write its result."""

import pytest

from rover_ncp.core.errors import FileError
from rover_ncp.core.files import require_writable


def test_file_that_exists_is_replaced_with_overwrite_alone(tmp_path):
    path = tmp_path / "new" / "page.html"
    require_writable(path)
    assert not path.parent.exists()
    path.parent.mkdir()
    path.touch()
    with pytest.raises(FileError, match="exists already; choose another file, or use --overwrite"):
        require_writable(path)
    require_writable(path, overwrite=True)
    with pytest.raises(FileError, match="new: cannot be written: Is a directory"):
        require_writable(path.parent, overwrite=True)
