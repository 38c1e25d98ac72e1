"""The benchmark of errors that last: its file is continued, never driven twice."""

from benchmarks.lasting import main


def test_a_run_that_was_cut_off_continues_with_the_same_trials(tmp_path, capsys):
    file = tmp_path / "drives.jsonl"
    run = [str(file), "--rows", "E6", "--seed", "3", "--trials"]
    main([*run, "2"])
    whole = file.read_text()
    main([*run, "1"])
    assert file.read_text() == whole
    file.write_text(whole[:-40])
    main([*run, "2"])
    assert file.read_text().splitlines()[-1] == whole.splitlines()[-1]
    assert file.read_text().startswith(whole.splitlines()[0])
    assert "E6                  2" in capsys.readouterr().out.splitlines()[-2]
