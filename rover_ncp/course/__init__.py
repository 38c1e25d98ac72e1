"""Courses beyond their file: reference motion, feasibility, building from poses."""
