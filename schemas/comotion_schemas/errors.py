"""The error of those who call or configure us, apart from defects of our own."""


class KnownError(ValueError):
    """Something given is wrong; the message says what, in one line.

    Commands print it without a trace. Any other :class:`ValueError` is a defect, whose trace is kept.
    """
