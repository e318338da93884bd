"""Views of a run for people and programs beside it: the page that `thigmo watch` serves."""
