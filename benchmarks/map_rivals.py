def measure(given):
    return "todo"
