"""Logs of real robots: read, checked, converted to the library's frames and units, and cut into attempts."""

from mjx_fit.data.logs.importing import ImportedLog, LoggedAttempt, import_log
from mjx_fit.data.logs.log_map import LogMap, read_map

__all__ = ["ImportedLog", "LogMap", "LoggedAttempt", "import_log", "read_map"]
