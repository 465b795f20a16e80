"""The table of questions: every analysis against every question, held against enumeration."""
