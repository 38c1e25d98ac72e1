"""Analysis of recorded drives as tables, charts and pages."""
