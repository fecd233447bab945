"""Keys, sessions of browsers, and answers to repeated requests."""
