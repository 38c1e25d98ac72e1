"""Charts of a drive as files, drawn with matplotlib."""
