"""What a person can put right, wherever it is found: raised there, printed by the command line as one line."""


class UserError(Exception):
    """Something the user can put right; the message is one clear line."""


class WrongUse(UserError):
    """What was asked for makes no sense, whatever is on the bus or in the log."""
