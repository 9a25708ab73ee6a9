"""The one exception root of boresight."""


class BoresightError(Exception):
    """A fault that a user can mend: the message says what is wrong, where, and what to do.

    The command line prints the message as one line and exits with code 2.
    """
