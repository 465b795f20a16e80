"""The best policy where nature picks each row from a set."""
