"""Forms of input: functions, dictionaries, lists and arrays, from which models are built."""
