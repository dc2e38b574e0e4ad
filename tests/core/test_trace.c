/* core/trace.c: the file, kernels on the host's clock, and `train --trace`.
 *
 * SPDX-License-Identifier: Apache-2.0
 */
#include "tests/kit.h"

#include <jansson.h>
#include <math.h>
#include <stdio.h>
#include <string.h>
#include <sys/stat.h>

#include "core/device/dev.h"
#include "core/pool.h"
#include "core/trace.h"

static const char STEP_CL[] = "__kernel void step_it(__global float *x, uint n)\n"
                              "{\n"
                              "    uint i = get_global_id(0);\n"
                              "    for (uint k = 0; i < n && k < 1000; k++)\n"
                              "        x[i] = 0.5f * x[i] + 1.0f;\n"
                              "}\n";

static void path_of(char *out, const char *name)
{
    struct err e = {0};
    kit_ok(file_join(out, kit_tmp, name, &e), e);
}

static json_t *trace_read(const char *path)
{
    json_error_t bad;
    json_t *j = json_load_file(path, 0, &bad);
    if (!j)
        fail_msg("%s:%d: %s", path, bad.line, bad.text);
    return j;
}

/* The sum of the lengths of spans of a track, in seconds, and how many there are. */
static double track_s(const json_t *trace, const char *track, size_t *n)
{
    double sum = 0.0;
    json_int_t id = -1;
    size_t i;
    const json_t *ev;
    *n = 0;
    json_array_foreach(json_object_get(trace, "traceEvents"), i, ev)
    {
        const char *ph = json_string_value(json_object_get(ev, "ph"));
        json_int_t tid = json_integer_value(json_object_get(ev, "tid"));
        const char *name = json_string_value(json_object_get(json_object_get(ev, "args"), "name"));
        if (!strcmp(ph, "M") && json_object_get(ev, "tid") && !strcmp(name, track))
            id = tid;
        if (!strcmp(ph, "X") && tid == id) {
            sum += json_number_value(json_object_get(ev, "dur")) * 1e-6;
            ++*n;
        }
    }
    return sum;
}

static void spans_end_in_a_file(void **state)
{
    char path[FILE_PATH_MAX];
    struct err e = {0};
    struct trace_result r;
    size_t n;
    path_of(path, "spans.json");
    assert_false(trace_on());
    trace_span("work", "nothing", 0.0, 1.0); /* nobody listens */
    kit_ok(trace_begin(path, &e), e);
    kit_fails(trace_begin(path, &e), ERR_ARG, e, "already");
    double t = clock_s();
    trace_span("work", "steps", t, t + 0.5);
    trace_span("work", "steps", t + 0.5, t + 0.75); /* it goes on */
    trace_span("work", "pruning", t + 0.75, t + 1.0);
    trace_span("photographs", "read", t, t + 0.25);
    assert_false(file_exists(path)); /* not before it is whole */
    kit_ok(trace_end(&r, &e), e);
    assert_int_equal(r.spans, 3);
    assert_int_equal(r.dropped, 0);
    assert_false(trace_on());
    json_t *j = trace_read(path);
    assert_true(fabs(track_s(j, "work", &n) - 1.0) < 1e-5);
    assert_int_equal(n, 2);
    assert_true(fabs(track_s(j, "photographs", &n) - 0.25) < 1e-5);
    json_decref(j);
    kit_ok(trace_end(&r, &e), e); /* nothing to do */
}

/* Spans that overlap are pairs of events with a number of their own. */
static void overlapping_spans_are_pairs(void **state)
{
    char path[FILE_PATH_MAX];
    struct err e = {0};
    struct trace_result r;
    double begun[2] = {-1, -1}, ended[2] = {-1, -1};
    json_int_t number[2] = {-1, -1};
    size_t i, n = 0;
    const json_t *ev;
    path_of(path, "overlap.json");
    kit_ok(trace_begin(path, &e), e);
    const double t = clock_s();
    trace_overlap("requests", "/a", t, t + 2);
    trace_overlap("requests", "/a", t + 2, t + 3); /* another one: they are not joined */
    kit_ok(trace_end(&r, &e), e);
    assert_int_equal(r.spans, 2);
    trace_overlap("requests", "/a", t, t + 1); /* of a thread that goes on */
    json_t *j = trace_read(path);
    json_array_foreach(json_object_get(j, "traceEvents"), i, ev)
    {
        const char *ph = json_string_value(json_object_get(ev, "ph"));
        const json_int_t id = json_integer_value(json_object_get(ev, "id"));
        if (!strcmp(ph, "b")) {
            assert_true(n < 2);
            number[n] = id;
            begun[n++] = json_number_value(json_object_get(ev, "ts"));
        }
        for (size_t k = 0; !strcmp(ph, "e") && k < n; k++)
            if (number[k] == id)
                ended[k] = json_number_value(json_object_get(ev, "ts"));
    }
    assert_int_equal(n, 2);
    assert_true(number[0] != number[1]);
    assert_true(fabs(ended[0] - begun[0] - 2e6) < 1 && fabs(ended[1] - begun[1] - 1e6) < 1);
    json_decref(j);
}

static void what_cannot_be_written_is_told_first(void **state)
{
    char path[FILE_PATH_MAX];
    struct err e = {0};
    path_of(path, "no/such/folder/t.json");
    kit_fails(trace_begin(path, &e), ERR_IO, e, "t.json");
    assert_false(trace_on());
}

static enum err_code nothing(void *user, size_t i, struct err *e)
{
    (void)user, (void)i, (void)e;
    return ERR_OK;
}

/* What a kernel took lies between the host's readings before and after it. */
static void kernels_are_on_the_clock_of_the_host(void **state)
{
    enum { N = 1 << 16, RUNS = 9000 }; /* more launches than a device keeps at a time */
    char path[FILE_PATH_MAX];
    struct dev d;
    struct err e = {0};
    struct trace_result r;
    cl_program p = NULL;
    cl_kernel k = NULL;
    cl_mem m = NULL;
    const struct dev_source src = {"tests/step.cl", STEP_CL};
    const cl_uint many = N, few = 1;
    size_t n;
    path_of(path, "kernels.json");
    double begin_s = clock_s();
    kit_ok(trace_begin(path, &e), e);
    double opened_s = clock_s();
    kit_ok(dev_open(NULL, &d, &e), e);
    kit_ok(dev_build(&d, &src, 1, NULL, &p, &e), e);
    kit_ok(dev_kernel(p, "step_it", &k, &e), e);
    kit_ok(dev_buffer(&d, N * sizeof(float), NULL, &m, &e), e);
    assert_int_equal(dev_arg(k, 0, m) | dev_arg(k, 1, many), CL_SUCCESS);
    kit_ok(dev_run(&d, k, "first", N, 64, &e), e); /* compiles */
    kit_ok(dev_finish(&d, &e), e);
    double from_s = clock_s();
    kit_ok(dev_run(&d, k, "long", N, 64, &e), e);
    kit_ok(dev_finish(&d, &e), e);
    double to_s = clock_s();
    assert_int_equal(dev_arg(k, 1, few), CL_SUCCESS);
    for (int i = 0; i < RUNS; i++)
        kit_ok(dev_run(&d, k, i % 2 ? "odd" : "even", 64, 64, &e), e);
    kit_ok(pool_for(3, 2, nothing, NULL, &e), e);
    dev_release(&m);
    clReleaseKernel(k);
    clReleaseProgram(p);
    dev_close(&d);
    kit_ok(trace_end(&r, &e), e);
    json_t *j = trace_read(path);
    (void)track_s(j, "device", &n);
    assert_int_equal(n, RUNS + 2);
    assert_int_equal(r.dropped, 0);
    (void)track_s(j, "host 1", &n);
    assert_int_equal(n, 1);
    size_t i;
    const json_t *ev;
    bool seen = false;
    json_array_foreach(json_object_get(j, "traceEvents"), i, ev)
    {
        if (strcmp(json_string_value(json_object_get(ev, "name")), "long") != 0)
            continue;
        double at = 1e-6 * json_number_value(json_object_get(ev, "ts")),
               long_s = 1e-6 * json_number_value(json_object_get(ev, "dur"));
        seen = true;
        /* ts counts from a time between these two */
        assert_true(at + opened_s > from_s - 0.005);
        assert_true(at + long_s + begin_s < to_s + 0.005);
        assert_true(long_s > 0.0);
    }
    assert_true(seen);
    json_decref(j);
}

static void training_leaves_a_trace(void **state)
{
    struct buf out = {0};
    char path[FILE_PATH_MAX];
    const char *bin = kit_program();
    size_t n;
    int rc = kit_run(&out,
                     "cd '%s' && '%s' synth -o city --photos 8 --extent-m 30 --width-px 96 "
                     "--height-px 72 -q && '%s' ingest city/images city/sparse -o scene -q && "
                     "'%s' train scene --iterations 60 --output a -q && "
                     "'%s' train scene --iterations 60 --output b --trace t.json -q",
                     kit_tmp, bin, bin, bin, bin);
    buf_u8(&out, 0);
    if (rc)
        fail_msg("%s", (char *)out.data);
    assert_non_null(strstr((char *)out.data, "cores were busy"));
    path_of(path, "t.json");
    json_t *j = trace_read(path);
    double device_s = track_s(j, "device", &n), work_s = track_s(j, "work", &n), read_s;
    assert_true(device_s > 0.0 && device_s < work_s);
    read_s = track_s(j, "photographs", &n);
    assert_true(n > 0 && read_s > 0.0);
    json_decref(j);
    /* the record changes nothing: same bytes, and the run can go on without it */
    assert_int_equal(
        kit_run(&out,
                "cd '%s' && for f in $(cd a/cells/all && ls *.ckpt); do cmp a/cells/all/$f "
                "b/cells/all/$f || exit 1; done && "
                "'%s' train scene --iterations 60 --output b -q | grep -q 'complete already'",
                kit_tmp, bin),
        0);
    /* a record is not replaced unasked */
    out.size = 0;
    assert_int_equal(kit_run(&out,
                             "cd '%s' && cp t.json kept.json && '%s' train scene --iterations 60 "
                             "--output c --trace t.json 2>&1; rc=$?; cmp t.json kept.json && exit "
                             "$rc",
                             kit_tmp, bin),
                     2);
    buf_u8(&out, 0);
    assert_non_null(strstr((char *)out.data, "another name"));
    out.size = 0;
    assert_int_equal(kit_run(&out,
                             "cd '%s' && '%s' train scene --iterations 60 --output c --jobs 2 "
                             "--trace u.json 2>&1",
                             kit_tmp, bin),
                     2);
    buf_u8(&out, 0);
    assert_non_null(strstr((char *)out.data, "--jobs"));
    buf_free(&out);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(spans_end_in_a_file),
        cmocka_unit_test(overlapping_spans_are_pairs),
        cmocka_unit_test(what_cannot_be_written_is_told_first),
        cmocka_unit_test(kernels_are_on_the_clock_of_the_host),
        cmocka_unit_test(training_leaves_a_trace),
    };
    return cmocka_run_group_tests(tests, kit_tmp_make, kit_tmp_remove);
}
