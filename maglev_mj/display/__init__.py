"""Contents that every viewer shows of a snapshot; no drawing.

And viewers in processes of their own.
"""
