"""What griffe must be told of our docstrings: whatever `Warns:` names is a UserWarning."""

import re

import griffe


class Warns(griffe.Extension):
    """Put the class of the warning in front of its text, where griffe looks for it."""

    def on_instance(self, *, obj, **kwargs):
        if obj.docstring:
            obj.docstring.value = re.sub(
                r"(?m)^(Warns:\n\s+)(?=\w+ )", r"\1UserWarning: ", obj.docstring.value
            )
