"""A small ray caster that draws laser-stripe images whose answer is known.

Everything lives in the belt frame: X along image x, Y towards the image's top, Z up from the belt, in
millimetres. The camera frame is OpenCV's (z forward), and the centre of the top-left pixel is (0, 0).
"""
