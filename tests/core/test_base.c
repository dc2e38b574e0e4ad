/* core/: errors, memory, buffers, files, random numbers, options, pool, Gaussian container.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "tests/kit.h"

#include <fcntl.h>
#include <math.h>
#include <signal.h>
#include <stdio.h>
#include <string.h>
#include <sys/wait.h>
#include <unistd.h>

#include <jansson.h>

#include "core/math/cholesky.h"
#include "core/math/sort.h"
#include "core/options/options.h"
#include "core/outdir.h"
#include "core/pool.h"

static void err_set_keeps_arguments_that_point_into_the_message(void **state)
{
    struct err e = {0};
    assert_int_equal(err_set(&e, ERR_IO, "disk full"), ERR_IO);
    assert_int_equal(err_add(&e, "cell %d", 3), ERR_IO);
    assert_string_equal(e.msg, "cell 3: disk full");
    err_set(&e, ERR_FORMAT, "again: %s", e.msg);
    assert_string_equal(e.msg, "again: cell 3: disk full");
    assert_int_equal(err_set(NULL, ERR_MEM, "x"), ERR_MEM);
}

/* What clients send is in log lines of JSON: they stay UTF-8 and JSON whatever it is. */
static void log_quote_writes_utf8(void **state)
{
    static const struct {
        const char *text, *want;
    } rows[] = {
        {"plain", "plain"},
        {"a\"b\\\x01", "a\\\"b\\\\\\u0001"},
        {"\xc3\xa4\xe2\x82\xac\xf0\x9f\x8c\x8d", "\xc3\xa4\xe2\x82\xac\xf0\x9f\x8c\x8d"},
        {"bad\xff!", "bad\\ufffd!"},
        {"\xc0\xaf", "\\ufffd\\ufffd"},                       /* a slash, too long */
        {"\xed\xa0\x80", "\\ufffd\\ufffd\\ufffd"},            /* half of a pair */
        {"\xf4\x90\x80\x80", "\\ufffd\\ufffd\\ufffd\\ufffd"}, /* beyond Unicode */
        {"cut \xe2\x82", "cut \\ufffd\\ufffd"},
    };
    char out[64];
    for (size_t i = 0; i < sizeof rows / sizeof *rows; i++) {
        assert_int_equal(log_quote(rows[i].text, out, sizeof out), strlen(rows[i].want));
        assert_string_equal(out, rows[i].want);
    }
}

static void mem_array_refuses_overflow_and_fails_on_demand(void **state)
{
    assert_null(mem_array(SIZE_MAX / 2, 3));
    assert_null(mem_array(SIZE_MAX, 1));
    void *p = mem_array(0, 8);
    assert_non_null(p);
    mem_free(p);
    mem_fail_at(2);
    p = mem_array(1, 1);
    assert_non_null(p);
    assert_null(mem_array(1, 1));
    mem_free(p);
    p = mem_array(1, 1); /* only the second one fails */
    assert_non_null(p);
    assert_int_equal((uintptr_t)p % 64, 0);
    mem_free(p);
}

static void arena_keeps_to_its_ceiling(void **state)
{
    struct arena a = {.limit_bytes = 1024};
    assert_non_null(arena_get(&a, 10, 100));
    assert_null(arena_get(&a, 1, 100));
    assert_non_null(arena_get(&a, 1, 8));
    arena_free(&a);
    assert_string_equal(arena_printf(&a, "%d-%s", 7, "x"), "7-x");
    arena_free(&a);
    arena_free(&a);
}

static void buf_and_cursor_round_trip_little_endian(void **state)
{
    struct buf b = {0};
    buf_u8(&b, 0xab);
    buf_u16(&b, 0x1234);
    buf_u32(&b, 0xdeadbeef);
    buf_u64(&b, UINT64_C(0x0102030405060708));
    buf_f32(&b, 1.5f);
    buf_f64(&b, -2.25);
    buf_printf(&b, "%s!", "hi");
    assert_int_equal(b.size, 1 + 2 + 4 + 8 + 4 + 8 + 3);
    assert_int_equal(b.data[1], 0x34);
    struct cursor c = cursor_over(b.data, b.size);
    assert_int_equal(cursor_u8(&c), 0xab);
    assert_int_equal(cursor_u16(&c), 0x1234);
    assert_int_equal(cursor_u32(&c), 0xdeadbeef);
    assert_true(cursor_u64(&c) == UINT64_C(0x0102030405060708));
    assert_true(cursor_f32(&c) == 1.5f);
    assert_true(cursor_f64(&c) == -2.25);
    assert_false(c.bad);
    assert_int_equal(cursor_left(&c), 3);
    assert_int_equal(cursor_u32(&c), 0);
    assert_true(c.bad);
    buf_free(&b);
}

static void buf_markup_leaves_nothing_that_opens_or_ends_markup(void **state)
{
    static const struct {
        const char *text, *want;
    } cases[] = {
        {"roof \u00e9 's.jpg", "roof \u00e9 &#39;s.jpg"},
        {"<a href=\"x\">A & B</a>", "&lt;a href=&quot;x&quot;&gt;A &amp; B&lt;/a&gt;"},
        {"&amp;", "&amp;amp;"}, /* what is escaped already is text too */
        {"a\x01\x1f\b\fz", "az"},
        {"two\r\n\tlines", "two\r\n\tlines"},
        {"", ""},
        {NULL, ""},
    };
    for (size_t i = 0; i < sizeof cases / sizeof *cases; i++) {
        struct buf b = {0};
        buf_markup(&b, cases[i].text);
        buf_u8(&b, 0);
        assert_string_equal((const char *)b.data, cases[i].want);
        buf_free(&b);
    }
}

static void file_write_replaces_whole_or_not_at_all(void **state)
{
    struct err e = {0};
    char dir[FILE_PATH_MAX], path[FILE_PATH_MAX], deep[FILE_PATH_MAX];
    kit_tmpdir(dir);
    kit_ok(file_join(path, dir, "a.bin", &e), e);
    kit_ok(file_write(path, "one", 3, &e), e);
    kit_ok(file_write(path, "three", 5, &e), e);
    struct buf b = {0};
    kit_ok(file_read(path, 0, &b, &e), e);
    assert_int_equal(b.size, 5);
    assert_memory_equal(b.data, "three", 5);
    buf_free(&b);
    kit_fails(file_read(path, 4, &b, &e), ERR_LIMIT, e, "a.bin");
    kit_fails(file_read(dir, 0, &b, &e), ERR_IO, e, "folder");
    kit_ok(file_join(deep, dir, "no/such/x", &e), e);
    kit_fails(file_write(deep, "x", 1, &e), ERR_IO, e, "no/such");
    kit_fails(file_read(deep, 0, &b, &e), ERR_NOENT, e, "no/such/x");
    kit_ok(file_join(deep, dir, "d/e", &e), e);
    kit_ok(file_mkdir(deep, &e), e);
    kit_ok(file_mkdir(deep, &e), e);
    kit_fails(file_mkdir(path, &e), ERR_IO, e, "not a folder");
    struct arena a = {0};
    char **names = NULL;
    size_t n = 0;
    const char *const suffixes[] = {".BIN", NULL};
    kit_ok(file_list(dir, suffixes, &a, &names, &n, &e), e);
    assert_int_equal(n, 1); /* no .part file is left */
    assert_string_equal(names[0], "a.bin");
    arena_free(&a);
    kit_rmdir(dir);
}

/* `NAME.part-MACHINE-PID` of a process that is gone. */
static void left_by_a_dead_process(const char *path, char part[FILE_PATH_MAX])
{
    struct err e = {0};
    const pid_t child = fork();
    if (child == 0)
        _exit(0);
    assert_int_equal(waitpid(child, NULL, 0), child);
    kit_ok(file_begin(path, part, &e), e);
    sprintf(strrchr(part, '-') + 1, "%ld", (long)child);
}

static void what_killed_processes_left_is_removed(void **state)
{
    struct err e = {0};
    struct outdir out;
    char dir[FILE_PATH_MAX], path[FILE_PATH_MAX], other[FILE_PATH_MAX], own[FILE_PATH_MAX],
        dead[FILE_PATH_MAX], away[FILE_PATH_MAX], inside[FILE_PATH_MAX], base[FILE_PATH_MAX + 8],
        kept[FILE_PATH_MAX];
    kit_tmpdir(dir);
    kit_ok(file_join(path, dir, "a.tiles", &e), e);
    kit_ok(file_join(other, dir, "a.tiles2", &e), e);
    kit_ok(file_begin(path, own, &e), e);
    left_by_a_dead_process(path, dead);
    memcpy(away, dead, sizeof away);
    char *const machine = away + strlen(path) + 6; /* another one */
    *machine = *machine == '0' ? '1' : '0';
    snprintf(base, sizeof base, "%s-base", dead); /* what a library put beside it */
    kit_ok(file_write(base, "1", 1, &e), e);
    kit_ok(file_join(kept, dir, "a.tiles.part-1", &e), e); /* a person's copy */
    kit_ok(file_mkdir(kept, &e), e);
    kit_ok(file_write(own, "1", 1, &e), e);
    kit_ok(file_write(away, "1", 1, &e), e);
    kit_ok(file_mkdir(dead, &e), e);
    kit_ok(file_join(inside, dead, "x", &e), e);
    kit_ok(file_write(inside, "1", 1, &e), e);
    kit_ok(file_write(other, "1", 1, &e), e);
    file_sweep(other);
    assert_true(file_exists(inside)); /* of another name */
    file_sweep(path);
    assert_false(file_exists(dead) || file_exists(base));
    assert_true(file_exists(own) && file_exists(away) && file_exists(other));
    file_sweep_locked(dir);
    assert_false(file_exists(own) || file_exists(away));
    assert_true(file_exists(other) && file_is_dir(kept));
    kit_ok(file_mkdir(dead, &e), e);
    kit_ok(outdir_begin(path, "marker", false, &out, &e), e);
    assert_false(file_exists(dead));
    outdir_abort(&out);
    kit_rmdir(dir);
    assert_false(file_exists(dir));
}

static void parts_of_files_are_read_and_written_whole(void **state)
{
    struct err e = {0};
    char dir[FILE_PATH_MAX], path[FILE_PATH_MAX], got[4] = "";
    kit_tmpdir(dir);
    kit_ok(file_join(path, dir, "a", &e), e);
    int fd = open(path, O_RDWR | O_CREAT | O_CLOEXEC, 0666);
    kit_ok(file_write_at(fd, path, "abc", 3, 2, &e), e);
    kit_ok(file_read_at(fd, path, got, 3, 2, &e), e);
    assert_memory_equal(got, "abc", 3);
    kit_fails(file_read_at(fd, path, got, 3, 3, &e), ERR_FORMAT, e, "truncated");
    close(fd);
    kit_fails(file_read_at(fd, path, got, 3, 0, &e), ERR_IO, e, path);
    kit_fails(file_write_at(fd, path, got, 3, 0, &e), ERR_IO, e, path);
    kit_rmdir(dir);
}

static void numbers_are_decimal_and_finite(void **state)
{
    static const char *const none[] = {"",      " ",    "nan",  "inf",   "-inf",
                                       "1e999", "0x10", "-0X1", "1,2 ",  "1,2,",
                                       ",1",    "1;2",  "1 ,2", "1,nan", "1,0x2"};
    double v[3];
    const char *p = " -1.5e2m";
    assert_true(number_list("1", 1, v) && v[0] == 1.0);
    assert_true(number_list(" -.5,+2.5e-1, 0", 3, v) && v[0] == -0.5 && v[1] == 0.25 && v[2] == 0);
    assert_true(number_read(&p, v) && v[0] == -150.0 && *p == 'm');
    assert_false(number_read(&p, v));
    assert_string_equal(p, "m");
    for (size_t i = 0; i < sizeof none / sizeof *none; i++)
        if (number_list(none[i], i < 8 ? 1 : 2, v))
            fail_msg("'%s' is taken for numbers", none[i]);
}

/* The vectors of RFC 4648, section 10, and one whose digits differ. */
static void base64_has_two_forms(void **state)
{
    static const struct {
        const char *bytes, *padded, *url;
    } rows[] = {{"", "", ""},
                {"f", "Zg==", "Zg"},
                {"fo", "Zm8=", "Zm8"},
                {"foo", "Zm9v", "Zm9v"},
                {"foobar", "Zm9vYmFy", "Zm9vYmFy"},
                {"\xfb\xff\xfe", "+//+", "-__-"}};
    char text[16], back[8];
    for (size_t i = 0; i < sizeof rows / sizeof *rows; i++) {
        const size_t n = strlen(rows[i].bytes);
        assert_int_equal(base64_write(rows[i].bytes, n, BASE64_PADDED, text),
                         strlen(rows[i].padded));
        assert_string_equal(text, rows[i].padded);
        assert_in_range(strlen(text), 0, base64_room(n) - 1);
        base64_write(rows[i].bytes, n, BASE64_URL, text);
        assert_string_equal(text, rows[i].url);
        assert_true(base64_read(text, back, n));
        assert_memory_equal(back, rows[i].bytes, n);
        assert_false(base64_read(text, back, n + 1));
    }
    assert_false(base64_read("Zm9+", back, 3));
}

static void file_write_to_a_full_disk_leaves_nothing(void **state)
{
    struct err e = {0};
    if (access("/dev/full", W_OK))
        skip();
    kit_fails(file_write("/dev/full/x", "x", 1, &e), ERR_IO, e, "/dev/full");
}

static void rng_is_uniform_normal_and_fixed(void **state)
{
    assert_true(rng_u64(1, 2, 3) == rng_u64(1, 2, 3));
    assert_true(rng_u64(1, 2, 3) != rng_u64(1, 3, 2));
    enum { N = 100000 };
    double mean = 0.0, mean_n = 0.0, var_n = 0.0;
    for (uint64_t i = 0; i < N; i++) {
        double u = rng_unit(7, 0, i), z = rng_normal(7, 1, i);
        assert_true(u >= 0.0 && u < 1.0);
        mean += u / N;
        mean_n += z / N;
        var_n += z * z / N;
    }
    /* Five standard errors of N samples: 0.29/sqrt(N), 1/sqrt(N), sqrt(2/N). */
    assert_true(fabs(mean - 0.5) < 0.0046);
    assert_true(fabs(mean_n) < 0.016);
    assert_true(fabs(var_n - 1.0) < 0.023);
}

static void jsonc_reads_comments_and_names_the_line(void **state)
{
    struct err e = {0};
    struct json_t *j = NULL;
    const char good[] = "// head\n{\n  // why\n  \"a\": 2.5, \"s\": \"// not a comment\"\n}\n";
    kit_ok(jsonc_parse(good, sizeof good - 1, "x.jsonc", &j, &e), e);
    double v = 0.0;
    const char *s = NULL;
    kit_ok(jsonc_num(j, "a", &v, &e), e);
    kit_ok(jsonc_text(j, "s", &s, &e), e);
    assert_true(v == 2.5);
    assert_string_equal(s, "// not a comment");
    kit_fails(jsonc_num(j, "s", &v, &e), ERR_FORMAT, e, "wrong type");
    kit_fails(jsonc_num(j, "b", &v, &e), ERR_FORMAT, e, "missing");
    json_decref(j);
    const char twice[] = "{\n\"a\": 1,\n\"a\": 2}";
    kit_fails(jsonc_parse(twice, sizeof twice - 1, "y.jsonc", &j, &e), ERR_FORMAT, e,
              "y.jsonc: line 3");
}

struct toy {
    OPTIONS_C_NUM edge_m;
    OPTIONS_C_INT count;
    OPTIONS_C_BOOL serve;
    OPTIONS_C_TEXT output, device;
    OPTIONS_C_ENUM aa;
};
static const struct options_def toy_defs[] = {
    OPTIONS_GROUP_ROW("a heading") OPTIONS_ROW(struct toy, NUM, EVERYDAY, edge_m, "180", 1, 5000,
                                               "m", "edge")
        OPTIONS_ROW(struct toy, INT, EVERYDAY, count, "3", 1, 8, "", "levels")
            OPTIONS_ROW(struct toy, BOOL, EVERYDAY, serve, "true", 0, 0, "", "serve")
                OPTIONS_ROW(struct toy, TEXT, EVERYDAY, output, "", 0, 0, "FILE", "out")
                    OPTIONS_ROW(struct toy, TEXT, EVERYDAY, device, "auto", 0, 0, "NAME", "on what")
                        OPTIONS_ROW(struct toy, ENUM, EVERYDAY, aa, "2d", 0, 0, "none|2d|mip",
                                    "anti-aliasing")};
static const struct options_spec toy_spec = {.command = "toy",
                                             .usage = "toy IN",
                                             .about = "Test.",
                                             .defs = toy_defs,
                                             .n_defs = sizeof toy_defs / sizeof toy_defs[0],
                                             .min_args = 1,
                                             .max_args = 2};

/* Parse a command line given as one text; words are split at spaces and live in the arena. */
static enum err_code toy_parse(struct toy *t, struct options_args *args, struct arena *a,
                               const char *line, struct err *e)
{
    char *argv[32];
    int argc = 0;
    for (char *p = arena_text(a, line); *p && argc < 31;) {
        argv[argc++] = p;
        p += strcspn(p, " ");
        if (*p)
            *p++ = '\0';
    }
    argv[argc] = NULL;
    return options_parse(&toy_spec, argc, argv, t, args, a, e);
}

static void options_come_from_defaults_then_files_then_flags(void **state)
{
    struct err e = {0};
    struct arena a = {0};
    struct toy t = {0};
    struct options_args args;
    char dir[FILE_PATH_MAX], path[FILE_PATH_MAX];
    kit_tmpdir(dir);
    kit_ok(file_join(path, dir, "c.jsonc", &e), e);
    const char text[] = "{\n// why\n\"edge_m\": 90, \"count\": 5, \"aa\": \"mip\"}";
    kit_ok(file_write(path, text, sizeof text - 1, &e), e);
    const char *line = arena_printf(&a, "toy in.x --count 4 --no-serve -o out --config %s", path);
    kit_ok(toy_parse(&t, &args, &a, line, &e), e);
    assert_true(t.edge_m == 90.0 && t.count == 4 && !t.serve && t.aa == 2);
    assert_string_equal(t.output, "out");
    assert_int_equal(args.n, 1);
    struct json_t *o = NULL;
    kit_ok(options_to_json(&toy_spec, &t, &o, &e), e);
    assert_string_equal(json_string_value(json_object_get(o, "aa")), "mip");
    json_decref(o);
    arena_free(&a);
    kit_rmdir(dir);
}

static void options_refuse_with_the_nearest_name(void **state)
{
    struct err e = {0};
    struct arena a = {0};
    struct toy t = {0};
    struct options_args args;
    const char *typo = "toy in --edge 5";
    kit_fails(toy_parse(&t, &args, &a, typo, &e), ERR_ARG, e, "--edge-m");
    const char *range = "toy in --edge-m=0.5";
    kit_fails(toy_parse(&t, &args, &a, range, &e), ERR_ARG, e, "from 1 to 5000 m");
    const char *nan_text = "toy in --edge-m nan";
    kit_fails(toy_parse(&t, &args, &a, nan_text, &e), ERR_ARG, e, "nan");
    const char *choice = "toy in --aa 3d";
    kit_fails(toy_parse(&t, &args, &a, choice, &e), ERR_ARG, e, "none|2d|mip");
    const char *empty = "toy in --output= --device=";
    kit_fails(toy_parse(&t, &args, &a, empty, &e), ERR_ARG, e, "--device: '' is not a value");
    const char *missing = "toy";
    kit_fails(toy_parse(&t, &args, &a, missing, &e), ERR_ARG, e, "too few");
    const char *value = "toy in --edge-m";
    kit_fails(toy_parse(&t, &args, &a, value, &e), ERR_ARG, e, "value is expected");
    const char *many = "toy a b c";
    kit_fails(toy_parse(&t, &args, &a, many, &e), ERR_ARG, e, "'c'");
    const char *heading = "toy in --=1"; /* headings have an empty key, and are no options */
    kit_fails(toy_parse(&t, &args, &a, heading, &e), ERR_ARG, e, "unknown option --");
    const char *form = "toy --help=html";
    kit_fails(toy_parse(&t, &args, &a, form, &e), ERR_ARG, e, "--help=html");
    arena_free(&a);
}

/* An option that is on is shown by the flag that turns it off, and is said to. */
static void help_of_a_switch_says_what_the_shown_flag_does(void **state)
{
    struct buf b = {0};
    assert_int_equal(kit_run(&b, "%s ingest --help=all", kit_program()), 0);
    buf_u8(&b, 0);
    const char *line = strstr((const char *)b.data, "--no-gimbal");
    assert_non_null(line);
    kit_expect_text(line, "Turn off: Use the gimbal", __FILE__, __LINE__);
    b.size = 0;
    assert_int_equal(kit_run(&b, "%s train --help=all", kit_program()), 0);
    line = strstr((const char *)b.data, "\n  --appearance ");
    assert_non_null(line);
    line += strlen("\n  --appearance");
    assert_memory_equal(line + strspn(line, " "), "Learn how", strlen("Learn how"));
    buf_free(&b);
}

static enum err_code square(void *user, size_t i, struct err *e)
{
    size_t *out = user;
    if (i >= 900)
        return err_set(e, ERR_DATA, "item %zu", i);
    out[i] = i * i;
    return ERR_OK;
}

static void pool_runs_each_once_and_reports_the_lowest_failure(void **state)
{
    struct err e = {0};
    static size_t out[1000];
    kit_ok(pool_for(900, 4, square, out, &e), e);
    for (size_t i = 0; i < 900; i++)
        assert_int_equal(out[i], i * i);
    kit_fails(pool_for(1000, 4, square, out, &e), ERR_DATA, e, "item 900");
    kit_ok(pool_for(0, 0, square, out, &e), e);
}

static void gauss_survives_growth_and_a_moved_origin(void **state)
{
    struct err e = {0};
    struct gauss g, h;
    kit_gauss(3, 50, 10.0, 2, 4, &g);
    kit_ok(gauss_alloc(&h, 1, 3, 0, &e), e);
    h.origin_enu_m[0] = 1e6;
    g.origin_enu_m[0] = 1e6 + 4.0;
    kit_ok(gauss_append(&h, &g, NULL, g.n, &e), e);
    assert_int_equal(h.n, 50);
    for (size_t i = 0; i < 50; i++) {
        assert_true(h.mean_m[3 * i] == g.mean_m[3 * i] + 4.0f);
        assert_true(h.sh[48 * i + 26] == g.sh[27 * i + 26]);
        assert_true(h.sh[48 * i + 27] == 0.0f);
        assert_true(h.quat_wxyz[4 * i + 3] == g.quat_wxyz[4 * i + 3]);
    }
    uint32_t order[50], seen[50] = {0};
    kit_ok(gauss_morton_order(&h, order, &e), e);
    for (size_t i = 0; i < 50; i++)
        seen[order[i]]++;
    for (size_t i = 0; i < 50; i++)
        assert_int_equal(seen[i], 1);
    memset(seen, 0, sizeof seen);
    kit_ok(gauss_hilbert_order(&h, order, &e), e);
    for (size_t i = 0; i < 50; i++)
        seen[order[i]]++;
    for (size_t i = 0; i < 50; i++)
        assert_int_equal(seen[i], 1);
    size_t first = 0;
    assert_int_equal(gauss_count_bad(&h, &first), 0);
    h.sh[48 * 7 + 3] = NAN;
    memset(&h.quat_wxyz[4 * 9], 0, 4 * sizeof(float));
    assert_int_equal(gauss_count_bad(&h, &first), 2);
    assert_int_equal(first, 7);
    h.scale_log[3 * 4 + 2] = GAUSS_SCALE_LOG_MOST;
    h.scale_log[3 * 5 + 1] = nextafterf(GAUSS_SCALE_LOG_MOST, INFINITY);
    assert_true(isfinite(expf(GAUSS_SCALE_LOG_MOST)));
    assert_int_equal(gauss_count_bad(&h, NULL), 2);
    assert_int_equal(gauss_count_unusable(&h, &first), 3);
    assert_int_equal(first, 5);
    gauss_free(&g);
    gauss_free(&h);
    gauss_free(&h);
}

/* Every cell of a cube of 16 has its own place, and the next one is across a face, so nothing
 * jumps.
 */
static void hilbert_curve_is_one(void **state)
{
    enum { EDGE = 16, CELLS = EDGE * EDGE * EDGE };
    struct sort_hilbert curve;
    static uint32_t at[CELLS][3];
    static bool seen[CELLS];
    sort_hilbert_init(&curve);
    for (uint32_t i = 0; i < CELLS; i++) {
        /* the cube's cells are the blocks of 2^17 an edge; the low bits do not matter */
        const uint32_t c[3] = {i % EDGE, i / EDGE % EDGE, i / EDGE / EDGE};
        const uint32_t cell[3] = {c[0] << 17, c[1] << 17, c[2] << 17};
        uint64_t place = sort_hilbert_key(&curve, cell) >> (3 * 17);
        assert_true(place < CELLS && !seen[place]);
        seen[place] = true;
        memcpy(at[place], c, sizeof c);
    }
    for (size_t i = 1; i < CELLS; i++) {
        uint32_t steps = 0;
        for (size_t k = 0; k < 3; k++)
            steps += at[i][k] > at[i - 1][k] ? at[i][k] - at[i - 1][k] : at[i - 1][k] - at[i][k];
        assert_int_equal(steps, 1);
    }
    const uint32_t last[3] = {(1u << 21) - 1, (1u << 21) - 1, (1u << 21) - 1};
    assert_true(sort_hilbert_key(&curve, last) >> 63 == 0);
}

static void gauss_alloc_fails_cleanly(void **state)
{
    struct err e = {0};
    struct gauss g;
    mem_fail_at(1);
    kit_fails(gauss_alloc(&g, 100, 3, 0, &e), ERR_MEM, e, "100 Gaussians");
    assert_null(g.block);
    kit_fails(gauss_alloc(&g, 1, 4, 0, &e), ERR_LIMIT, e, "SH degree 4");
}

static int float_compare(const void *a, const void *b)
{
    float x = *(const float *)a, y = *(const float *)b;
    return (x > y) - (x < y);
}

static int double_compare(const void *a, const void *b)
{
    const double x = *(const double *)a, y = *(const double *)b;
    return (x > y) - (x < y);
}

/* As qsort sorts them, few and many: of both signs, of all sizes, floats, equal ones, 0 of both
 * signs, infinities. */
static void sorts_of_doubles(void **state)
{
    enum { MANY = 20000 };
    static double v[MANY], want[MANY];
    static const size_t counts[] = {0, 1, 2, 48, 1000, MANY};
    for (size_t c = 0; c < sizeof counts / sizeof *counts; c++)
        for (size_t kind = 0; kind < 5; kind++) {
            const size_t n = counts[c];
            for (size_t i = 0; i < n; i++) {
                double x = rng_normal(7, kind, i);
                v[i] = kind == 0   ? x
                       : kind == 1 ? ldexp(x, (int)(rng_unit(7, 8, i) * 2000) - 1000)
                       : kind == 2 ? (double)(float)x
                       : kind == 3 ? floor(3 * x)
                                   : (i % 5 == 0   ? -HUGE_VAL
                                      : i % 7 == 0 ? HUGE_VAL
                                                   : x);
                if (kind == 3 && v[i] == 0 && i % 2)
                    v[i] = -0.0;
                want[i] = v[i];
            }
            if (n)
                qsort(want, n, sizeof *want, double_compare);
            sort_doubles(v, n);
            for (size_t i = 0; i < n; i++)
                assert_true(v[i] == want[i]);
        }
}

/* Words by their upper half, equal ones in the order they came; selection as sorting would. */
static void sorts_of_words_and_selection(void **state)
{
    enum { MANY = 5000 };
    static uint64_t words[MANY], scratch[MANY];
    static float x[MANY], sorted[MANY];
    const size_t counts[] = {0, 1, 2, 3, 7, 100, MANY};
    for (size_t c = 0; c < sizeof counts / sizeof *counts; c++)
        for (uint64_t kind = 0; kind < 5; kind++) {
            size_t n = counts[c];
            for (size_t i = 0; i < n; i++) {
                uint64_t r = rng_u64(kind, 3, i);
                uint32_t key = (uint32_t)(kind == 0   ? r
                                          : kind == 1 ? r % 5
                                          : kind == 2 ? 77
                                          : kind == 3 ? n - i
                                                      : (r % 3) << 30);
                words[i] = (uint64_t)key << 32 | i;
                x[i] = sorted[i] = (float)(int32_t)key;
            }
            sort_words(words, scratch, n);
            for (size_t i = 1; i < n; i++)
                assert_true(words[i - 1] < words[i]); /* the lower half counts up among equals */
            qsort(sorted, n, sizeof *sorted, float_compare);
            for (size_t k = 0; k < n; k += n / 6 + 1)
                assert_true(sort_select(x, n, k) == sorted[k]);
        }
    float odd[5] = {NAN, 2.0f, NAN, 1.0f, NAN}; /* comes to an end */
    (void)sort_select(odd, 5, 2);
}

static void blocks_are_appended_as_rows_are(void **state)
{
    struct err e = {0};
    struct gauss g, rows, block;
    kit_gauss(5, 300, 40, 3, 8, &g);
    g.origin_enu_m[1] = 33.3;
    kit_ok(gauss_alloc(&rows, 0, 3, 8, &e), e);
    kit_ok(gauss_uninit(&block, 0, 3, 8, &e), e);
    for (uint32_t i = 0; i < g.n; i++)
        kit_ok(gauss_append(&rows, &g, &i, 1, &e), e);
    kit_ok(gauss_append(&block, &g, NULL, 100, &e), e);
    g.mean_m += 300, g.scale_log += 300, g.quat_wxyz += 400, g.opacity_logit += 100;
    g.sh += 4800, g.embed += 800;
    kit_ok(gauss_append(&block, &g, NULL, 200, &e), e);
    assert_memory_equal(rows.mean_m, block.mean_m, 3600);
    assert_memory_equal(rows.scale_log, block.scale_log, 3600);
    assert_memory_equal(rows.quat_wxyz, block.quat_wxyz, 4800);
    assert_memory_equal(rows.opacity_logit, block.opacity_logit, 1200);
    assert_memory_equal(rows.sh, block.sh, 300 * 192);
    assert_memory_equal(rows.embed, block.embed, 300 * 32);
    gauss_free(&g);
    gauss_free(&rows);
    gauss_free(&block);
}

/* A list grows when it is full, keeps what it holds, and stays as it was when memory is short. */
static void mem_room_doubles_and_keeps(void **state)
{
    size_t n = 0, cap = 0;
    uint32_t *list = NULL;
    for (uint32_t i = 0; i < 13; i++) {
        uint32_t *more = mem_room(list, n, &cap, 3, sizeof *more);
        assert_non_null(more);
        if (n && n != 3 && n != 6 && n != 12)
            assert_ptr_equal(more, list);
        list = more;
        list[n++] = i;
    }
    assert_int_equal(cap, 24);
    for (uint32_t i = 0; i < 13; i++)
        assert_int_equal(list[i], i);
    n = cap;
    mem_fail_at(1);
    assert_null(mem_room(list, n, &cap, 3, sizeof *list));
    mem_fail_at(0);
    assert_int_equal(cap, 24);
    assert_int_equal(list[12], 12);
    size_t huge = SIZE_MAX / 2 + 2;
    assert_null(mem_room(list, huge, &huge, 3, sizeof *list));
    mem_free(list);
}

/* A factor gives its matrix again, what is solved solves it, and a matrix that is singular in its
 * last row is refused. */
static void small_systems_are_factored_and_solved(void **state)
{
    enum { N = 7, STRIDE = 9 };
    double a[N][STRIDE] = {{0}}, l[N][STRIDE];
    for (size_t k = 0; k < 2 * N; k++)
        for (size_t i = 0; i < N; i++)
            for (size_t j = 0; j < N; j++)
                a[i][j] += (rng_unit(1, k, i) - 0.5) * (rng_unit(1, k, j) - 0.5);
    memcpy(l, a, sizeof l);
    for (size_t i = 0; i < N; i++)
        for (size_t j = i + 1; j < N; j++)
            l[i][j] = 99.0; /* not read */
    assert_true(cholesky_factor(&l[0][0], N, STRIDE));
    for (size_t i = 0; i < N; i++)
        for (size_t j = 0; j <= i; j++) {
            double sum = 0.0;
            for (size_t k = 0; k <= j; k++)
                sum += l[i][k] * l[j][k];
            assert_true(fabs(sum - a[i][j]) < 1e-12);
            assert_true(l[i][j] == l[j][i]);
        }
    double x[N];
    for (size_t i = 0; i < N; i++)
        x[i] = rng_unit(2, 0, i);
    cholesky_solve(&l[0][0], N, STRIDE, x, x);
    for (size_t i = 0; i < N; i++) {
        double sum = -rng_unit(2, 0, i);
        for (size_t j = 0; j < N; j++)
            sum += a[i][j] * x[j];
        assert_true(fabs(sum) < 1e-10);
    }
    for (size_t j = 0; j < N; j++) /* the last row is the one before */
        a[N - 1][j] = j + 1 < N ? a[N - 2][j] : a[N - 2][N - 2];
    assert_false(cholesky_factor(&a[0][0], N, STRIDE));
}

/* Each lane as if it were alone, to the bit; one of them is not positive definite. */
static void systems_side_by_side_are_those_alone(void **state)
{
    enum { N = 7, STRIDE = 9, BAD = 3 };
    double a[N * STRIDE][CHOLESKY_LANES] = {{0}}, x[N][CHOLESKY_RIGHT][CHOLESKY_LANES];
    double one[CHOLESKY_LANES][N * STRIDE] = {{0}};
    bool ok[CHOLESKY_LANES];
    for (size_t lane = 0; lane < CHOLESKY_LANES; lane++)
        for (size_t i = 0; i < N; i++)
            for (size_t j = 0; j <= i; j++) {
                double v = rng_unit(7, lane, N * i + j) + (i == j ? (double)N : 0.0);
                a[i * STRIDE + j][lane] = one[lane][i * STRIDE + j] = lane == BAD ? -v : v;
            }
    for (size_t i = 0; i < N; i++)
        for (size_t side = 0; side < CHOLESKY_RIGHT; side++)
            for (size_t lane = 0; lane < CHOLESKY_LANES; lane++)
                x[i][side][lane] = rng_unit(8, lane, N * side + i);
    cholesky_factor_lanes(a, N, STRIDE, ok);
    cholesky_solve_lanes(a, N, STRIDE, x);
    for (size_t lane = 0; lane < CHOLESKY_LANES; lane++) {
        assert_int_equal(cholesky_factor(one[lane], N, STRIDE), lane != BAD);
        assert_int_equal(ok[lane], lane != BAD);
        for (size_t side = 0; lane != BAD && side < CHOLESKY_RIGHT; side++) {
            double alone[N];
            for (size_t i = 0; i < N; i++)
                alone[i] = rng_unit(8, lane, N * side + i);
            cholesky_solve(one[lane], N, STRIDE, alone, alone);
            for (size_t i = 0; i < N; i++)
                assert_true(x[i][side][lane] == alone[i]);
        }
    }
}

/* In a child, as the flag stays set: is it set after SIGHUP? */
static int hung_up(void (*before)(int))
{
    int status = -1;
    const pid_t pid = fork();
    if (!pid) {
        signal(SIGHUP, before);
        signals_catch();
        raise(SIGHUP); /* by the shell */
        raise(SIGHUP); /* by the kernel */
        _exit(signals_stopping());
    }
    assert_int_equal(waitpid(pid, &status, 0), pid);
    assert_true(WIFEXITED(status));
    return WEXITSTATUS(status);
}

static void a_closed_terminal_stops_what_nohup_keeps(void **state)
{
    assert_int_equal(hung_up(SIG_DFL), 1);
    assert_int_equal(hung_up(SIG_IGN), 0);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(systems_side_by_side_are_those_alone),
        cmocka_unit_test(err_set_keeps_arguments_that_point_into_the_message),
        cmocka_unit_test(mem_array_refuses_overflow_and_fails_on_demand),
        cmocka_unit_test(mem_room_doubles_and_keeps),
        cmocka_unit_test(arena_keeps_to_its_ceiling),
        cmocka_unit_test(sorts_of_doubles),
        cmocka_unit_test(sorts_of_words_and_selection),
        cmocka_unit_test(small_systems_are_factored_and_solved),
        cmocka_unit_test(blocks_are_appended_as_rows_are),
        cmocka_unit_test(buf_and_cursor_round_trip_little_endian),
        cmocka_unit_test(buf_markup_leaves_nothing_that_opens_or_ends_markup),
        cmocka_unit_test(file_write_replaces_whole_or_not_at_all),
        cmocka_unit_test(what_killed_processes_left_is_removed),
        cmocka_unit_test(parts_of_files_are_read_and_written_whole),
        cmocka_unit_test(numbers_are_decimal_and_finite),
        cmocka_unit_test(base64_has_two_forms),
        cmocka_unit_test(file_write_to_a_full_disk_leaves_nothing),
        cmocka_unit_test(rng_is_uniform_normal_and_fixed),
        cmocka_unit_test(jsonc_reads_comments_and_names_the_line),
        cmocka_unit_test(options_come_from_defaults_then_files_then_flags),
        cmocka_unit_test(options_refuse_with_the_nearest_name),
        cmocka_unit_test(help_of_a_switch_says_what_the_shown_flag_does),
        cmocka_unit_test(pool_runs_each_once_and_reports_the_lowest_failure),
        cmocka_unit_test(gauss_survives_growth_and_a_moved_origin),
        cmocka_unit_test(hilbert_curve_is_one),
        cmocka_unit_test(gauss_alloc_fails_cleanly),
        cmocka_unit_test(log_quote_writes_utf8),
        cmocka_unit_test(a_closed_terminal_stops_what_nohup_keeps),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
