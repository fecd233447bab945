"""Settings on their way into a child process."""

import os

from pydantic_settings import BaseSettings

SECRETS = frozenset({"SAWMILL_TOKEN", "SAWMILL_TOKEN_FILE"})


def environment_with(*settings: BaseSettings) -> dict[str, str]:
    """The environment of this process with these settings as the variables they are read from; null ones are unset.

    The service's token stays with the service: its children read strangers' files and need none.
    """
    environment = {name: value for name, value in os.environ.items() if name.upper() not in SECRETS}
    for group in settings:
        prefix = group.model_config.get("env_prefix", "")
        for name, value in group.model_dump(mode="json").items():
            variable = f"{prefix}{name}".upper()
            if value is None:
                environment.pop(variable, None)
            else:
                environment[variable] = str(value)
    return environment
