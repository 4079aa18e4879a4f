"""Online identification of seal and actuator friction beside the drive."""

__version__ = "0.1.0"
