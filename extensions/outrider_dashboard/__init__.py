"""Show a run in the browser while it is flown, and steer it.

One process, one session on the bus. `sources` tell what happens, `hub` hands it to the browsers, `chart_data` keeps
what the charts need, `controls` are the cards that can be touched (its `wheel` lets one browser at a time drive a
UGV), `address` and `page_guard` hold the token and the bounds on requests, `shell` lays the page out, `app` puts them
together. The pictures are drawn in the browser, by the files in `static`. Nothing is fetched from elsewhere.
"""
