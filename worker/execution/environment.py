"""Settings on their way into a child process."""

import os

from pydantic_settings import BaseSettings


def environment_with(*settings: BaseSettings) -> dict[str, str]:
    """The environment of this process with these settings as the variables they are read from; null ones are unset."""
    environment = dict(os.environ)
    for group in settings:
        prefix = group.model_config.get("env_prefix", "")
        for name, value in group.model_dump(mode="json").items():
            variable = f"{prefix}{name}".upper()
            if value is None:
                environment.pop(variable, None)
            else:
                environment[variable] = str(value)
    return environment
