// Where `citysplat serve` answers otherwise than nginx 1.22 with the same bytes, and why. differ.mjs takes the first row
// that fits: `field` that differs, `when` of the request, and what the two answer. `answers` are the statuses of all
// answers on the connection: those to the request, and to a plain one behind it. `alone`: libmicrohttpd 1.0 or newer, which
// reads requests without our screen before it.
//
// SPDX-License-Identifier: Apache-2.0
const is = (...tags) => (r) => tags.some((t) => r.what.has(t));
const sent = (pattern) => (r) => pattern.test(r.text);
const first = (answers) => answers.split(" ")[0];
const any = /./;

export const table = [
    // ---- nginx refuses more ----
    { what: "an empty Host, or one of dots alone", when: sent(/^Host:( \.\.)?$/im), field: "answers", ours: any, nginx: /^400/,
        why: "RFC 9112 (3.2) has an empty Host where the target has no authority, and RFC 3986 dots in a name. No address is made of it." },
    { what: "If-None-Match twice", when: sent(/^If-None-Match(.|\s)*^If-None-Match/im), field: "answers", ours: any, nginx: /^400/,
        why: "RFC 9110 (5.3) lets a recipient join the two. The first alone is used: at worst a whole answer is sent." },
    { what: "If-Unmodified-Since without a date", when: sent(/^If-Unmodified-Since: nonsense/im), field: "answers", ours: any, nginx: /^412/,
        why: "RFC 9110 (13.1.4): a field that is no date is ignored." },
    { what: "If-Unmodified-Since of a tile", when: (r) => is("tile")(r) && is("header unmodified")(r), field: "answers", ours: any, nginx: /^412/,
        why: "RFC 9110 (13.1.4): ignored where there is no date. A tile has none: its address has the revision." },
    { what: "the connection ends after a refusal", when: () => true, field: "answers", pair: (a, b) => first(a) === b && /^4/.test(b),
        why: "nginx closes after 412, and after 405 of TRACE and CONNECT. RFC 9112 (9.3) leaves it to the server where the request was whole." },
    // ---- bytes that are no request of RFC 9112 ----
    { what: "a request without a version", when: is("version "), field: "answers", ours: /^(400|414|431)/, nginx: any,
        why: "HTTP/0.9 has no head, so the answer could be taken for anything. RFC 9112 has no such request." },
    { what: "a version that is not 1.x of one digit", when: is("version HTTP/1.10", "version HTTP/0.9", "version HTTP/2.0", "version HTTX/1.1", "version http/1.1"), field: "answers",
        ours: /^(400|505|414|431)/, nginx: any, why: "RFC 9112 (2.3): one digit each; 505 says what is wrong with another major version." },
    { what: "spaces in the request line", when: is("end spaces", "end tab"), field: "answers", ours: /^400/, nginx: any,
        why: "RFC 9112 (3): one space each. What several mean is guessed otherwise by others." },
    { what: "a line that is no field", when: is("header name"), field: "answers", ours: /^400/, nginx: any,
        why: "nginx leaves it out. RFC 9112 (5.1) asks for 400 where a space is before the colon; the rest is no field either." },
    { what: "bytes that no value has", when: is("header value"), field: "answers", ours: /^400/, nginx: any,
        why: "Control bytes, and lines that are continued: RFC 9110 (5.5) and RFC 9112 (5.2) let a server refuse them." },
    { what: "a Host that is no name", when: is("host bad"), field: "answers", ours: /^400/, nginx: any,
        why: "RFC 9112 (3.2): 400 for an invalid value. nginx takes `a@b` and `a,b`." },
    { what: "a long line", when: is("header long", "target long"), field: "answers", ours: /^(414|431)/, nginx: any,
        why: "Headers have 16 KB, and no address has more than 2 KB. 414 and 431 say which; nginx has 400 for a field." },
    { what: "bytes that no target has", when: is("target control", "target form", "target badabsolute"), field: "answers", ours: /^400/, nginx: any,
        why: "RFC 9112 (3.2): 400 for an invalid request line; a fragment is never sent." },
    { what: "an absolute target without a path", when: sent(/^\w+ +http:\/\/files\.example +HTTP/), field: "answers", ours: any, nginx: /^403/,
        why: "It is the path `/`, where citysplat has a page and the folder of nginx has none." },
    // ---- bodies ----
    { what: "a body, or the length of one, where none is expected", when: (r) => [...r.what].some((t) => t.startsWith("body ")), field: "answers", ours: /^(400|413|501)/, nginx: any,
        why: "RFC 9110 (9.3.1): a body of GET has no meaning, and refusing it is no risk of another reading of the connection." },
    { what: "Expect: 100-continue without a body", when: sent(/^Expect: 100-/im), field: "answers", ours: /^closed/, nginx: any,
        why: "RFC 9110 (10.1.1): a client must not send it. libmicrohttpd 0.9.75 sends 100 and closes if another request is there already." },
    // ---- addresses and methods ----
    { what: "another spelling of an address", when: is("target escapes", "target dots", "target slashes", "target badescapes", "target badquery", "target missing"), field: "answers",
        ours: /^(400|404)/, nginx: any, why: "No address of the server has an escape, dots, or `//`, so an answer has one address and caches one copy. nginx looks for files." },
    { what: "a method that is not known", when: is("method PROPFIND", "method PATCH", "method get", "method G@T"), field: "answers", ours: /^(501|405)/, nginx: any,
        why: "RFC 9110 (9.1): 501 for a method that is not known to the server. nginx has 405 and 400." },
    { what: "OPTIONS", when: is("method OPTIONS"), field: "answers", ours: /^204/, nginx: any, why: "Pages of other sites ask with it (CORS)." },
    // ---- conditions and ranges ----
    { what: "If-None-Match before If-Modified-Since", when: sent(/^If-None-Match(.|\s)*^If-Modified-Since|^If-Modified-Since(.|\s)*^If-None-Match/im), field: "answers", ours: any, nginx: any,
        why: "RFC 9110 (13.1.3): If-Modified-Since is ignored beside If-None-Match. nginx asks both." },
    { what: "If-Modified-Since of a tile", when: (r) => is("tile")(r) && is("header since", "header both")(r), field: "answers", ours: any, nginx: /^304/,
        why: "A tile has no date, and an entity tag." },
    { what: "a tile by its query", when: is("target query"), field: "answers", ours: /^(200|412)/, nginx: /^(304|206|412)/, why: "`?sh=0` is another tile with another tag." },
    { what: "HEAD with a range", when: is("method HEAD"), field: "answers", ours: /^200/, nginx: /^(206|416)/, why: "RFC 9110 (14.2): Range is defined for GET alone." },
    { what: "ranges of a document", when: (r) => is("doc")(r) && sent(/^(If-)?Range:/im)(r), field: "answers", ours: /^200/, nginx: /^(206|416)/,
        why: "A document that is also kept compressed has no ranges (`Accept-Ranges` is missing)." },
    { what: "a tag of the other form", when: (r) => is("doc")(r) && is("header coding")(r) && is("header nonematch", "header both", "header ifrange", "header match")(r), field: "answers", ours: /^(200|412)/,
        nginx: /^(304|200|206)/, why: "The compressed document has a strong tag of its own; that of nginx is weak." },
    { what: "a range with spaces in it", when: sent(/^Range: bytes=[^\r]* /im), field: "answers", ours: /^200/, nginx: /^206/, why: "RFC 9110 (14.1.1) has none there: the field is ignored." },
    { what: "a range that is none", when: sent(/^Range:/im), field: "answers", ours: /^200/, nginx: /^416/,
        why: "RFC 9110 (14.2): a field that is not valid is ignored." },
    { what: "several ranges", when: sent(/^Range: *bytes=[^\r]*,/im), field: "answers", ours: /^200/, nginx: /^206/,
        why: "RFC 9110 (14.2): a server may ignore Range. No client of tiles asks for several." },
    { what: "the end of a range in more digits than nginx reads", when: sent(/^Range: bytes=\d*-\d{19}/im), field: "answers", ours: /^206/, nginx: /^416/,
        why: "RFC 9110 (14.1.2): what is beyond the end of the file is cut. nginx's number overflows." },
    { what: "If-Range by a date", when: (r) => is("tile")(r) && sent(/^If-Range: (DATE|Thu)/im)(r), field: "answers", ours: /^200/, nginx: /^206/,
        why: "A tile has no date, so the whole tile is sent." },
    // ---- of answers with one status ----
    { what: "ranges of a document", when: is("doc"), field: "accepts", ours: /none/, nginx: /bytes/, why: "As above." },
    { what: "a tile by its query", when: is("target query", "target badquery", "target long"), field: "body", ours: any, nginx: any, why: "`?sh=0` is another tile; nginx sends the same file." },
    // ---- libmicrohttpd 1.0 ----
    { what: "a line that ends with LF alone", alone: true, when: is("end lf", "end onelf", "end leadinglf"), field: "answers", ours: /^(400|closed)/, nginx: any,
        why: "RFC 9112 (2.2): a recipient may take it for the end of a line, and need not. At strictness 1 the library does not." },
    { what: "a request line that is none is not answered", alone: true, when: is("end tab", "end spaces", "target control", "target badabsolute", "target long", "version "), field: "answers",
        ours: /^closed/, nginx: /^(0|4)/, why: "It closes at once: nothing is read as another request, and a client that sends such bytes reads no problem document." },
    { what: "a part of a tile by its query", when: is("target query"), field: "range", ours: any, nginx: any, why: "As above." },
];
