"""The page that the demo writes."""

from sawmill_worker.demo_page import Section, write_page


def test_the_page_shows_every_part_of_a_section_escaped(tmp_path):
    section = Section("scan <1>", "R & D", ("", "found <i>"))
    section.rows.append(("tilt", "<0.3>"))
    section.facts.append(("error <mm>", "0.1"))
    section.pictures.append(("log's.png", 'a "log"'))
    section.files.append(("a&b.h5", "<slices>"))
    write_page(tmp_path / "index.html", [section])
    page = (tmp_path / "index.html").read_text()
    escaped = ("scan &lt;1&gt;", "R &amp; D", "found &lt;i&gt;", "&lt;0.3&gt;", "error &lt;mm&gt;", "&lt;slices&gt;")
    assert all(text in page for text in escaped)
    assert '<img src="log&#39;s.png" alt="a &#34;log&#34;">' in page
    assert '<a href="a&amp;b.h5">a&amp;b.h5</a>' in page


def test_what_is_only_quotes_cannot_leave_an_attribute(tmp_path):
    section = Section("t", "t", ("",), pictures=[("x.png", '"><script>alert(1)</script>')])
    write_page(tmp_path / "index.html", [section])
    assert "<script" not in (tmp_path / "index.html").read_text()
