"""What commands leave in a folder."""


def content(folder):
    """Return the bytes of every file below a folder, by its path."""
    return {str(p.relative_to(folder)): p.read_bytes() for p in sorted(folder.rglob("*")) if p.is_file()}
