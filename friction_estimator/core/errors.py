"""Failures a user can cause. Each message says what is wrong, where, and what to do."""


class FrictionEstimatorError(Exception):
    """Base of all expected failures: the command line prints one line and exits with `exit_code`."""

    exit_code = 2


class InputError(FrictionEstimatorError):
    """Usage or unreadable input (exit code 2)."""


class ConfigError(InputError):
    """A configuration value that cannot be used; names the parameter and the reason (exit code 2)."""


class UnanswerableError(FrictionEstimatorError):
    """Readable data that cannot answer: no such topic, no usable sample (exit code 1)."""

    exit_code = 1
