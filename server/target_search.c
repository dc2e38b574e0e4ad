/* The query of a search for appearances: where, when, at what hour, in what light, how sorted,
 * which page.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "server/target.h"

#include <string.h>

#include "server/text.h"

/* ---- time ---- */

/* So many digits, no more and no fewer, in [lo, hi]. */
static bool target_take_digits(struct text *t, int n, uint32_t lo, uint32_t hi, uint32_t *out)
{
    uint32_t v = 0;
    for (int i = 0; i < n; i++, t->p++) {
        if (!text_is_digit(t))
            return false;
        v = 10 * v + (uint32_t)(*t->p - '0');
    }
    *out = v;
    return v >= lo && v <= hi;
}

static uint32_t target_month_days(uint32_t year, uint32_t month)
{
    static const uint8_t days[12] = {31, 28, 31, 30, 31, 30, 31, 31, 30, 31, 30, 31};
    const bool leap = (year % 4 == 0 && year % 100 != 0) || year % 400 == 0;
    return days[month - 1] + (month == 2 && leap);
}

/* Days since 1970-01-01 of the Gregorian calendar. */
static int64_t target_days(uint32_t year, uint32_t month, uint32_t day)
{
    const int64_t before = (int64_t)year - 1;
    int64_t n = before * 365 + before / 4 - before / 100 + before / 400 - 719162;
    for (uint32_t m = 1; m < month; m++)
        n += target_month_days(year, m);
    return n + day - 1;
}

bool target_read_time(const char *text, size_t n, int64_t *from_s, int64_t *to_s)
{
    struct text t = {text, text + n};
    uint32_t year, month, day, hour = 0, minute = 0, second = 0;
    if (!target_take_digits(&t, 4, 1, 9999, &year) || !text_take(&t, "-") ||
        !target_take_digits(&t, 2, 1, 12, &month) || !text_take(&t, "-") ||
        !target_take_digits(&t, 2, 1, target_month_days(year, month), &day))
        return false;
    const bool whole_day = text_at_end(&t);
    if (!whole_day &&
        (!(text_take(&t, "T") || text_take(&t, "t")) || !target_take_digits(&t, 2, 0, 23, &hour) ||
         !(text_take(&t, ":") || text_take(&t, "%3A") || text_take(&t, "%3a")) ||
         !target_take_digits(&t, 2, 0, 59, &minute) ||
         !(text_take(&t, ":") || text_take(&t, "%3A") || text_take(&t, "%3a")) ||
         !target_take_digits(&t, 2, 0, 60, &second)))
        return false;
    if (!whole_day && text_take(&t, ".")) {
        if (!text_is_digit(&t))
            return false;
        while (text_is_digit(&t))
            t.p++;
    }
    if (!whole_day && !text_take(&t, "Z"))
        (void)text_take(&t, "z");
    *from_s = target_days(year, month, day) * 86400 + hour * 3600 + minute * 60 + second;
    if (to_s)
        *to_s = *from_s + (whole_day ? 86399 : 0);
    return text_at_end(&t);
}

static enum err_code target_take_interval(struct text *one, struct target_search *q, struct err *e)
{
    int64_t unused;
    const char *slash = memchr(one->p, '/', (size_t)(one->end - one->p)), *from = one->p,
               *to = slash ? slash + 1 : one->p;
    const char *escaped = NULL;
    for (const char *p = one->p; !slash && !escaped && one->end - p >= 3; p++)
        if (p[0] == '%' && p[1] == '2' && (p[2] | 32) == 'f')
            escaped = p;
    if (escaped) {
        slash = escaped;
        to = escaped + 3;
    }
    const size_t n_from = (size_t)((slash ? slash : one->end) - from),
                 n_to = (size_t)(one->end - to);
    const bool open_from = slash && (!n_from || (n_from == 2 && !memcmp(from, "..", 2)));
    const bool open_to = slash && (!n_to || (n_to == 2 && !memcmp(to, "..", 2)));
    q->time_s[0] = INT64_MIN;
    q->time_s[1] = INT64_MAX;
    if ((!open_from && !target_read_time(from, n_from, &q->time_s[0], &unused)) ||
        (!open_to && !target_read_time(to, n_to, &unused, &q->time_s[1])))
        return err_set(e, ERR_FORMAT,
                       "datetime is a date, a time as in 2024-06-01T10:00:00Z, or two of them "
                       "joined by /, where .. is open; by the clocks of the cameras, without an "
                       "offset");
    if (q->time_s[0] > q->time_s[1])
        return err_set(e, ERR_DATA, "datetime ends before it begins");
    q->has_time = true;
    one->p = one->end;
    return ERR_OK;
}

/* ---- the rest ---- */

static bool target_take_comma(struct text *t)
{
    return text_take(t, ",") || text_take(t, "%2C") || text_take(t, "%2c");
}

/* Longitude and latitude in 1e-7 degrees, or more of them. */
static enum err_code target_take_degrees(struct text *one, int n, const char *name, int32_t *out,
                                         struct err *e)
{
    for (int i = 0; i < n; i++) {
        int64_t v;
        const int64_t most = i % 2 ? 900000000 : 1800000000;
        if ((i && !target_take_comma(one)) || !text_take_fixed(one, 7, &v))
            return err_set(e, ERR_FORMAT, "%s is numbers with commas, degrees", name);
        if (v < -most || v > most)
            return err_set(e, ERR_DATA, "%s: no longitude and latitude", name);
        out[i] = (int32_t)v;
    }
    return ERR_OK;
}

static enum err_code target_take_near(struct text *one, struct target_search *q, struct err *e)
{
    int64_t radius;
    enum err_code rc = target_take_degrees(one, 2, "near", q->near_e7, e);
    q->has_near = true;
    if (rc || !target_take_comma(one))
        return rc;
    if (!text_take_fixed(one, 3, &radius))
        return err_set(e, ERR_FORMAT, "near is lon,lat or lon,lat,radius in metres");
    if (radius < 1 || radius > 4000000000)
        return err_set(e, ERR_DATA, "near: the radius is 0.001 to 4000000 m");
    q->radius_e3 = (uint32_t)radius;
    return ERR_OK;
}

static enum err_code target_take_hours(struct text *one, struct target_search *q, struct err *e)
{
    uint32_t from, to;
    if (!text_take_uint(one, &from) || !text_take(one, "-") || !text_take_uint(one, &to))
        return err_set(e, ERR_FORMAT, "hours is two hours of the day, as in 17-20");
    if (from > 23 || to > 24 || from == to)
        return err_set(e, ERR_DATA,
                       "hours: from 0 to 23, to another one, at most 24; 22-4 is over "
                       "midnight");
    q->hours[0] = (uint8_t)from;
    q->hours[1] = (uint8_t)to;
    q->has_hours = true;
    return ERR_OK;
}

static enum err_code target_take_colour(struct text *one, struct target_search *q, struct err *e)
{
    struct paint p = {0};
    const size_t n = (size_t)(one->end - one->p);
    if (n != 6 || !target_read_background(one->p, n, &p) || p.background != BACKGROUND_COLOUR)
        return err_set(e, ERR_FORMAT, "colour is RRGGBB: what mid grey looks like in that light");
    q->rgb = p.rgb;
    q->has_colour = true;
    one->p = one->end;
    return ERR_OK;
}

static const char *const target_sorts[] = {[SEARCH_BY_NUMBER] = "number",
                                           [SEARCH_BY_DISTANCE] = "distance",
                                           [SEARCH_BY_TIME] = "time",
                                           [SEARCH_BY_COLOUR] = "colour"};

static enum err_code target_take_sort(struct text *one, struct target_search *q, struct err *e)
{
    for (int i = SEARCH_BY_NUMBER; i <= SEARCH_BY_COLOUR; i++) {
        struct text at = *one;
        if (!text_take(&at, target_sorts[i]) || !text_at_end(&at))
            continue;
        q->sort = (enum search_sort)i;
        *one = at;
        return ERR_OK;
    }
    return err_set(e, ERR_FORMAT, "sort is number, distance, time or colour");
}

static enum err_code target_take_count(struct text *one, const char *name, uint32_t lo, uint32_t hi,
                                       uint32_t *out, struct err *e)
{
    return text_take_uint(one, out) && *out >= lo && *out <= hi
               ? ERR_OK
               : err_set(e, ERR_FORMAT, "%s is a number, %u to %u", name, lo, hi);
}

enum {
    SEARCH_BBOX,
    SEARCH_NEAR,
    SEARCH_DATETIME,
    SEARCH_HOURS,
    SEARCH_COLOUR,
    SEARCH_SORT,
    SEARCH_LIMIT,
    SEARCH_AFTER,
    SEARCH_KEPT,
    SEARCH_KEYS
};
static const char *const target_search_keys[SEARCH_KEYS] = {
    "bbox=", "near=", "datetime=", "hours=", "colour=", "sort=", "limit=", "after=", "kept="};

/* What follows the `key`-th word. */
static enum err_code target_take_search(struct text *one, int key, struct target *out,
                                        struct err *e)
{
    enum err_code rc;
    switch (key) {
    case SEARCH_BBOX:
        rc = target_take_degrees(one, 4, "bbox", out->bbox_e7, e);
        out->has_bbox = true;
        return !rc && out->bbox_e7[1] > out->bbox_e7[3]
                   ? err_set(e, ERR_DATA, "bbox is west,south,east,north: south is above north")
                   : rc;
    case SEARCH_NEAR:
        return target_take_near(one, &out->search, e);
    case SEARCH_DATETIME:
        return target_take_interval(one, &out->search, e);
    case SEARCH_HOURS:
        return target_take_hours(one, &out->search, e);
    case SEARCH_COLOUR:
        return target_take_colour(one, &out->search, e);
    case SEARCH_SORT:
        return target_take_sort(one, &out->search, e);
    case SEARCH_LIMIT:
        return target_take_count(one, "limit", 1, TARGET_SEARCH_MAX, &out->limit, e);
    case SEARCH_AFTER:
        return target_take_count(one, "after", 0, 999999999, &out->after, e);
    default:
        out->search.kept = true;
        return text_take(one, "true") ? ERR_OK
                                      : err_set(e, ERR_FORMAT, "kept is true, or left out");
    }
}

static bool target_is_signature(struct text *one)
{
    return text_take(one, "exp=") || text_take(one, "key=") || text_take(one, "scope=") ||
           text_take(one, "sig=");
}

enum err_code target_parse_search(const char *query, size_t n, struct target *out, struct err *e)
{
    unsigned seen = 0;
    out->limit = TARGET_SEARCH;
    for (struct text t = {query, query + n}; !text_at_end(&t);) {
        const char *amp = memchr(t.p, '&', (size_t)(t.end - t.p));
        struct text one = {t.p, amp ? amp : t.end};
        int key = 0;
        t.p = amp ? amp + 1 : t.end;
        if (target_is_signature(&one))
            continue;
        while (key < SEARCH_KEYS && !text_take(&one, target_search_keys[key]))
            key++;
        if (key == SEARCH_KEYS || seen >> key & 1)
            return err_set(e, ERR_FORMAT,
                           "the query may hold bbox, near, datetime, hours, colour, kept, sort, "
                           "limit and after, each once");
        seen |= 1u << key;
        enum err_code rc = target_take_search(&one, key, out, e);
        if (!rc && !text_at_end(&one))
            rc = err_set(e, ERR_FORMAT, "the query has a malformed value");
        if (rc)
            return rc;
    }
    struct target_search *q = &out->search;
    q->asked = seen != 0;
    if (!(seen >> SEARCH_SORT & 1))
        q->sort = q->has_near     ? SEARCH_BY_DISTANCE
                  : q->has_colour ? SEARCH_BY_COLOUR
                                  : SEARCH_BY_NUMBER;
    if ((q->sort == SEARCH_BY_DISTANCE && !q->has_near) ||
        (q->sort == SEARCH_BY_COLOUR && !q->has_colour))
        return err_set(e, ERR_FORMAT, "sort=distance is from near, sort=colour from colour");
    return ERR_OK;
}

/* ---- again ---- */

static void target_add_degrees(struct buf *out, const char *name, const int32_t *v_e7, int n)
{
    for (int i = 0; i < n; i++) {
        const int64_t v = v_e7[i], size = v < 0 ? -v : v;
        buf_printf(out, "%s%s%lld.%07lld", i ? "," : name, v < 0 ? "-" : "",
                   (long long)(size / 10000000), (long long)(size % 10000000));
    }
}

static void target_add_time(struct buf *out, int64_t s)
{
    int64_t days = s / 86400 - (s % 86400 < 0), second = s - days * 86400;
    uint32_t year = 1, month = 1;
    if (s == INT64_MIN || s == INT64_MAX) {
        buf_printf(out, "..");
        return;
    }
    for (uint32_t step = 4096; step; step /= 2)
        if (year + step <= 9999 && target_days(year + step, 1, 1) <= days)
            year += step;
    while (month < 12 && target_days(year, month + 1, 1) <= days)
        month++;
    buf_printf(out, "%04u-%02u-%02uT%02u:%02u:%02uZ", year, month,
               (unsigned)(days - target_days(year, month, 1) + 1), (unsigned)(second / 3600),
               (unsigned)(second / 60 % 60), (unsigned)(second % 60));
}

void target_search_query(const struct target *t, uint32_t after, struct buf *out)
{
    const struct target_search *q = &t->search;
    buf_printf(out, "?sort=%s", target_sorts[q->sort]);
    if (t->has_bbox)
        target_add_degrees(out, "&bbox=", t->bbox_e7, 4);
    if (q->has_near)
        target_add_degrees(out, "&near=", q->near_e7, 2);
    if (q->radius_e3)
        buf_printf(out, ",%u.%03u", q->radius_e3 / 1000, q->radius_e3 % 1000);
    if (q->has_time) {
        buf_printf(out, "&datetime=");
        target_add_time(out, q->time_s[0]);
        buf_printf(out, "/");
        target_add_time(out, q->time_s[1]);
    }
    if (q->has_hours)
        buf_printf(out, "&hours=%u-%u", q->hours[0], q->hours[1]);
    if (q->has_colour)
        buf_printf(out, "&colour=%06x", (unsigned)q->rgb);
    if (q->kept)
        buf_printf(out, "&kept=true");
    buf_printf(out, "&limit=%u&after=%u", t->limit, after);
}
