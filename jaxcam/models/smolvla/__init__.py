"""SmolVLA: a small vision language model, and an action expert trained by flow matching.

Two forms of it: the paper's, where the expert attends in every layer to the prefix and itself, all
of it causally and all of it trained; and LeRobot's, where every other layer of the expert only
reads the prefix, pictures and words see each other, and only the expert is trained.
"""
