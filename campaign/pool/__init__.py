"""Worker processes, and the limits that a method works under."""
