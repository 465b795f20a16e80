"""Other ways to write a model: functions, dictionaries and lists."""
