"""What of a source file is compared."""

from deblur_avatar.config.syntax import cpp_tokens


def test_cpp_comments_and_strings_are_told_apart():
    text = 'auto a = "/* no */" + R"x(// no)")x" + \'"\' + 1\'000; // yes "\nb = c ++ + d;'
    assert cpp_tokens(text) == [
        "auto", "a", "=", '"/* no */"', "+", 'R"x(// no)")x"', "+", "'\"'", "+", "1'000", ";",
        "b", "=", "c", "++", "+", "d", ";",
    ]  # fmt: skip
