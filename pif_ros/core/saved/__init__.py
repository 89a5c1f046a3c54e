"""What a tracker remembers, as arrays and back."""

from pif_ros.core.saved.beliefs import Arrays, Form, Forms
from pif_ros.core.saved.memory import arrays_of, forms_of, memory_from

__all__ = ['Arrays', 'Form', 'Forms', 'arrays_of', 'forms_of', 'memory_from']
