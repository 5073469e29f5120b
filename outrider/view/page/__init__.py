"""`outrider dashboard`: a web page that shows a live run and lets people steer it.

One process, one session on the bus. `hub` takes what the simulator tells and hands it to the browsers, `history`
keeps what
the charts need, `wheel` lets one browser at a time drive a UGV, `guard` says who may look, `page` lays the page
out, `app` puts
them together. The pictures are drawn in the browser, by the files in `static`. Nothing is fetched from elsewhere.
"""

LOOPBACK = ("127.0.0.1", "localhost", "::1")
"""Addresses that only this machine reaches."""
