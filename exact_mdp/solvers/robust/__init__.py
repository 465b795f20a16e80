"""The best policy if nature picks each row from a set."""
