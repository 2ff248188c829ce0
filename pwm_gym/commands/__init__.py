"""The subcommands of ``pwm-gym``: one dataclass each, whose fields are its options and whose ``run`` does the work."""
