"""What can be wrong with a table, said so that people know what to do."""

from vantage.errors import UserError


class TableTrouble(UserError):
    """Something about the table, its files or its cameras; the text says what is wrong and what to do."""
