"""Files that a result may replace."""

import pytest
from kit.recorded_drives import write_drive

from deploy.view.page import write_report
from rover_ncp.core.errors import FileError
from rover_ncp.core.files import JPEG, PDF, RECORDING_KIND, begins_with, require_creatable, require_writable
from rover_ncp.recording.recording import RecordingWriter


def test_result_replaces_its_own_kind_an_empty_file_and_nothing(tmp_path):
    picture = begins_with("a picture", JPEG, PDF)
    path = tmp_path / "picture"
    for content in (None, b"", b"%PDF-1.7", b"\xff\xd8\xff"):
        if content is not None:
            path.write_bytes(content)
        require_writable(path, kind=picture)
    path.write_bytes(b"by hand")
    require_writable(path)
    with pytest.raises(FileError, match="picture: exists and is not a picture; choose another file"):
        require_writable(path, kind=picture)


def test_result_does_not_replace_an_input_by_another_name(tmp_path):
    path, link = tmp_path / "poses.yaml", tmp_path / "link.yaml"
    path.write_text("by hand")
    link.symlink_to(path)
    with pytest.raises(FileError, match=r"link\.yaml: is the command's own input"):
        require_writable(link, inputs=[tmp_path / "missing", path])
    require_writable(tmp_path / "new.yaml", inputs=[tmp_path / "new.yaml"])


def test_recording_replaces_only_a_recording_with_overwrite(tmp_path):
    path = tmp_path / "run.mcap"
    RecordingWriter(path).close()
    require_creatable(path, overwrite=True, kind=RECORDING_KIND)
    path.write_text("by hand")
    with pytest.raises(FileError, match=r"run\.mcap: exists and is not a recording"):
        require_creatable(path, overwrite=True, kind=RECORDING_KIND)


def test_report_replaces_an_earlier_report(tmp_path):
    write_drive(tmp_path / "run.mcap", course="tests/data/short_course.yaml")
    pages = [write_report(tmp_path / "run.mcap", tmp_path / "run.html") for _ in range(2)]
    assert pages[0] == pages[1]
