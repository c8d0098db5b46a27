"""Plain tables that are wrong: one sentence with the line, and nothing else."""

import pytest

from swarmssm.errors import InputError
from swarmssm.io import read


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("", "the file is empty"),
        ("\n\n", "no header and no rows"),
        ("frame,id,x,y\n", "it has a header but no rows"),
        ("frame,id,x,y\n0,a,1,2\n", "it has 1 frame; motion needs at least 2"),
        ("0,1,2,3\n1,1,2,3\n", "its first line holds numbers. Put a header there"),
        ("apples,pears\n1,2\n2,3\n", "no columns of positions are recognised among apples, pears"),
        ("frame,id,x\n0,a,1\n1,a,1\n", "has a column x but no column y"),
        ("id,x,y\na,1,2\na,2,3\n", "none for frame or time"),
        ("frame,x1,y1,x2\n0,1,2,3\n1,1,2,3\n", "individual '2' has 'x2' but no column of y"),
        ("frame,x1,y1,x1,y1\n0,1,2,3,4\n1,1,2,3,4\n", "column 'x1' stands there more than once"),
        ("frame,id,x,y,x\n0,a,1,2,3\n1,a,1,2,3\n", "column 'x' stands there more than once"),
        ("frame,x,y,head_x,head_y\n0,1,2,3,4\n1,1,2,3,4\n", "x and y and also 'head_x'"),
        ("frame,id,x,y\n0,a,1,2\n1,a,oops,3\n", "line 3, column 'x': 'oops' is not a number"),
        ("frame,id,x,y\n0,a,1,2\n1,a,1_000,3\n", "line 3, column 'x': '1_000' is not a number"),
        ("frame,id,x,y\n0,a,1,2\n\n1,a,3\n", "line 4 has 3 cells and the header 4"),
        ("frame,id,x,y\n0,a,1,2\n1,a,3,4,5\n", "line 3 has 5 cells and the header 4"),
        ("frame,id,x,y\n0,a,1,2\n1,a,inf,4\n", "line 3, column 'x' is inf. Leave the cell empty"),
        ("frame,id,x,y\n0,a,1,2\n1,a,1e400,4\n", "line 3, column 'x' is inf"),
        ("frame,id,x,y\n0,a,1,2\n1,a,1e13,4\n", r"individual a in row 1 is x = 1e\+13"),
        ("frame,id,x,y\n0,a,1,2\n1,,3,4\n", "line 3 has no individual. Fill it in"),
        ("frame,id,x,y\n0,a,1,2\n,a,3,4\n", "line 3 has no frame. Fill it in"),
        ("frame,id,x,y\n0,a,1,2\n1.5,a,3,4\n", r"the frame in line 3 is 1.5; it must be a whole"),
        (
            "frame,id,x,y\n0,a,1,2\n1,a,3,4\n1,a,5,6\n",
            "individual 'a' stands twice at frame 1, in line 3 and line 4",
        ),
        ("time,x1,y1\n0,1,2\n2,1,2\n1,1,2\n", r"time in line 4 \(1\) falls below that of the row"),
        ("time,x1,y1\n0,1,2\n1,1,2\n1,1,2\n", r"time in line 4 \(1\) repeats"),
        ("frame,x1,y1\n5,1,2\n4,1,2\n", r"frame in line 3 \(4\) falls below"),
        ("time,x1,y1\n0,1,2\n1,1,2\n2,1,2\n3.4,1,2\n", "time in line 5 comes 1.4 s after"),
        ("time,x1,y1\n0,1,2\nnoon,1,2\n", "line 3, column 'time': 'noon' is not a number"),
        ("time,x1,y1\nnoon,1,2\n1,1,2\n", "line 2: 'noon' is no time. Write seconds"),
        ("time,x1,y1\n,1,2\n,1,2\n", "the time in line 2 is nan; mend it or take the row away"),
        ("time,x1,y1\n0,1,2\n.1,1,2\n.2,1,2\n1e10,1,2\n", r"time in line 5 leaps to 1e\+10 s"),
        ("time,x1,y1\n0,1,2\n1e13,1,2\n", r"the time in line 3 is 1e\+13; mend it"),
        (
            "frame,x1,y1,z1,x2,y2\n0,1,2,3,4,5\n1,1,2,3,4,5\n",
            "individual '2' has no z and others have",
        ),
        ("time,x1,y1\n0,1,2\n1e-9,1,2\n", "frames per second must lie between 0 and 1e"),
        ("frame,x1,y1\n0,1,2\n1,1,2\n1000000,1,2\n", "3 rows span 1000001 frames"),
        ("frame,x1,y1,x2,y2\n0,1,2,,\n1,1,2,,\n", "individual 2 has no position in any frame"),
    ],
)
def test_a_bad_table_is_one_sentence(tmp_path, text, sentence):
    path = tmp_path / "t.csv"
    path.write_text(text)
    # Where the rate is not the point, it is given, so that it is not what is missed.
    fps = None if text.startswith("time") else 10
    with pytest.raises(InputError, match=sentence) as caught:
        read(path, fps=fps)
    assert str(path) in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    "content",
    [bytes(range(256)) * 4, b"frame,id,x,y\n0,a,1,\x00\n", b"\xff\xfeabc", b"\x7fELF\x02\x01\x01"],
)
def test_a_binary_file_called_csv(tmp_path, content):
    path = tmp_path / "t.csv"
    path.write_bytes(content)
    with pytest.raises(InputError, match="this is not a text file"):
        read(path, fps=10)
