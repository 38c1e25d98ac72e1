"""The command ``mock``: a simulated base in real time, for programs that drive one."""
