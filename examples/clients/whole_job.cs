// Do the whole job of a scanner's software in C# 7, without packages: whole_job ADDRESS SCAN.h5
// docs/do/connect.md explains each step. SAWMILL_KEY is the key, where one is needed.
// .NET Framework 4.7, .NET 8 and Mono compile it. With Debian's mono-devel:
//   mcs -r:System.Net.Http -r:System.Runtime.Serialization -r:System.Xml -r:System.Xml.Linq whole_job.cs
using System;
using System.Globalization;
using System.IO;
using System.Net;
using System.Net.Http;
using System.Net.Http.Headers;
using System.Runtime.Serialization.Json;
using System.Text;
using System.Threading;
using System.Threading.Tasks;
using System.Xml;
using System.Xml.Linq;

// A refusal of the service: its code is for programs, its message for people.
class RefusedException : Exception
{
    public readonly int Status;
    public readonly string Code;
    public RefusedException(int status, string code, string detail) : base($"{code}: {detail}")
    {
        Status = status;
        Code = code;
    }
    public bool MayContinue =>
        Status == 429 || Status == 503 || Code == "wrong-offset" || Code == "upload-busy";
}

static class WholeJob
{
    static readonly HttpClient http = new HttpClient { Timeout = Timeout.InfiniteTimeSpan };
    static string address;

    static async Task<HttpResponseMessage> Send(HttpRequestMessage request, TimeSpan limit)
    {
        using (var cancel = new CancellationTokenSource(limit))
        {
            var response = await http.SendAsync(request, HttpCompletionOption.ResponseHeadersRead, cancel.Token);
            if (response.IsSuccessStatusCode)
                return response;
            using (response)
            {
                var status = (int)response.StatusCode;
                if (response.Content.Headers.ContentType?.MediaType != "application/problem+json")
                    throw new HttpRequestException($"{status} is not the service's answer");
                var problem = await Json(response);
                throw new RefusedException(status, problem.Element("code").Value, problem.Element("detail").Value);
            }
        }
    }

    // JSON as elements of XML, which every .NET reads without a package.
    static async Task<XElement> Json(HttpResponseMessage response)
    {
        var bytes = await response.Content.ReadAsByteArrayAsync();
        using (var reader = JsonReaderWriterFactory.CreateJsonReader(bytes, XmlDictionaryReaderQuotas.Max))
            return XElement.Load(reader);
    }

    static async Task<XElement> Answer(HttpRequestMessage request)
    {
        using (request)
        using (var response = await Send(request, TimeSpan.FromSeconds(60)))
            return await Json(response);
    }

    static bool IsBroken(Exception error) =>
        error is HttpRequestException || error is IOException || error is OperationCanceledException;

    // Repeats and refusals
    static async Task<XElement> Again(Func<HttpRequestMessage> make)
    {
        for (var pause = 1; ; pause *= 2)
        {
            try
            {
                return await Answer(make());
            }
            catch (Exception error) when (pause < 16
                && (IsBroken(error) || error is RefusedException refused && (refused.Status == 429 || refused.Status == 503)))
            {
                await Task.Delay(TimeSpan.FromSeconds(pause));
            }
        }
    }

    static Task<XElement> Get(string path) => Again(() => new HttpRequestMessage(HttpMethod.Get, address + path));

    // A POST that makes one thing, however often it is repeated.
    static Task<XElement> Once(string path, string json = null)
    {
        var key = Guid.NewGuid().ToString();
        return Again(() =>
        {
            var request = new HttpRequestMessage(HttpMethod.Post, address + path);
            request.Headers.Add("Idempotency-Key", key);
            if (json != null)
                request.Content = new StringContent(json, Encoding.UTF8, "application/json");
            return request;
        });
    }

    static string Id(XElement resource) => resource.Element("id").Value;

    static string State(XElement resource) => resource.Element("state").Value;

    static async Task Save(string path, string file)
    {
        using (var request = new HttpRequestMessage(HttpMethod.Get, address + path))
        using (var response = await Send(request, TimeSpan.FromSeconds(60)))
        using (var sink = File.Create(file))
            await response.Content.CopyToAsync(sink);
    }

    static async Task Run(string stack)
    {
        // 1. Describe the scanner
        var constants = "{\"source_to_cor_mm\": 859.46, \"num_detector_pixels\": 768, \"detector_pitch_mm\": 1.502864583}";
        var scanner = Id(await Once("/v1/scanners", $"{{\"name\": \"Line 2\", \"constants\": {constants}}}"));

        // 2. Send the scan
        var upload = await SendInParts(stack);
        var about = $"scanner_id={scanner}&data=counts&phantom_id=l-shape&phantom_rows=0:3";
        var scan = Id(await Once($"/v1/scans?upload_id={upload}&{about}"));

        // 3. Ask for a calibration
        var asked = await Once("/v1/calibrations", $"{{\"scan_id\": \"{scan}\", \"activate\": false}}");

        // 4. Wait
        var path = $"/v1/calibrations/{Id(asked)}";
        var calibration = await Ended(path);

        // 5. Read the verdict
        var bound = calibration.Element("predicted_ray_error_mm").Element("upper_95").Value;
        var rays = double.Parse(bound, CultureInfo.InvariantCulture).ToString("F3", CultureInfo.InvariantCulture);
        Console.WriteLine($"calibration: {calibration.Element("verdict").Value}, rays within {rays} mm");
        Console.WriteLine($"next step: {(await Get(path + "/next-step")).Element("headline").Value}");
        await Save(path + "/report.png", "report.png");

        // 6. Accept the calibration
        await Once(path + "/activate");

        // 7. Reconstruct the log
        var log = await Once("/v1/reconstructions", $"{{\"scan_id\": \"{scan}\", \"rows\": \"3:6\"}}");
        await Ended($"/v1/reconstructions/{Id(log)}");
        await Save($"/v1/reconstructions/{Id(log)}/slices/0.png", "slice.png");
        await Download($"/v1/reconstructions/{Id(log)}/volume.h5", "volume.h5");

        // 8. Check a log for drift
        var check = await Once("/v1/drifts", $"{{\"scan_id\": \"{scan}\", \"rows\": \"3:6\"}}");
        var drift = await Ended($"/v1/drifts/{Id(check)}");
        Console.WriteLine($"drift: {drift.Element("result").Element("reason").Value}");

        // 9. Follow the events
        using (var request = new HttpRequestMessage(
            HttpMethod.Get, $"{address}/v1/events?scanner_id={scanner}&after=0&duration_s=2"))
        using (var response = await Send(request, TimeSpan.FromSeconds(60)))
        using (var lines = new StreamReader(await response.Content.ReadAsStreamAsync()))
            for (string line; (line = await lines.ReadLineAsync()) != null;)
                if (line.StartsWith("event: ", StringComparison.Ordinal))
                    Console.WriteLine(line.Substring(7));
    }

    // An upload that holds the whole file.
    static async Task<string> SendInParts(string file)
    {
        using (var stream = File.OpenRead(file))
        {
            var upload = await Once("/v1/uploads", $"{{\"size_bytes\": {stream.Length}}}");
            var buffer = new byte[16 * 1024 * 1024];
            while (State(upload) == "receiving")
            {
                var offset = long.Parse(upload.Element("offset_bytes").Value, CultureInfo.InvariantCulture);
                stream.Position = offset;
                var length = await stream.ReadAsync(buffer, 0, buffer.Length);
                try
                {
                    var part = new HttpRequestMessage(new HttpMethod("PATCH"), $"{address}/v1/uploads/{Id(upload)}")
                    {
                        Content = new ByteArrayContent(buffer, 0, length),
                    };
                    part.Headers.Add("Upload-Offset", offset.ToString(CultureInfo.InvariantCulture));
                    part.Content.Headers.ContentType = new MediaTypeHeaderValue("application/octet-stream");
                    upload = await Answer(part);
                }
                catch (Exception error) when (
                    IsBroken(error) || error is RefusedException refused && refused.MayContinue)
                {
                    await Task.Delay(TimeSpan.FromSeconds(1));
                    upload = await Get($"/v1/uploads/{Id(upload)}"); // has the offset at which to continue
                }
            }
            return Id(upload);
        }
    }

    // The resource after its job has succeeded; a failure is an exception.
    static async Task<XElement> Ended(string path)
    {
        XElement resource;
        do
            resource = await Get(path + "?wait=30");
        while (State(resource) == "queued" || State(resource) == "running");
        if (State(resource) != "succeeded")
            throw new InvalidOperationException($"{path} {State(resource)}: {resource.Element("failure").Value}");
        return resource;
    }

    // Save a file of any size; continue an interrupted download where it ended.
    static async Task Download(string path, string file)
    {
        EntityTagHeaderValue tag = null;
        using (var sink = File.Create(file))
            for (var attempt = 1; ; attempt++)
                try
                {
                    using (var request = new HttpRequestMessage(HttpMethod.Get, address + path))
                    {
                        if (tag != null)
                        {
                            request.Headers.Range = new RangeHeaderValue(sink.Length, null);
                            request.Headers.IfRange = new RangeConditionHeaderValue(tag);
                        }
                        using (var response = await Send(request, TimeSpan.FromSeconds(60)))
                        {
                            if (response.StatusCode == HttpStatusCode.OK)
                                sink.SetLength(0); // the whole file, not the rest of it
                            tag = response.Headers.ETag;
                            sink.Position = sink.Length;
                            await response.Content.CopyToAsync(sink);
                            return;
                        }
                    }
                }
                catch (Exception error) when (attempt < 5 && IsBroken(error))
                {
                    await Task.Delay(TimeSpan.FromSeconds(attempt));
                }
    }

    static int Main(string[] arguments)
    {
        if (arguments.Length != 2)
        {
            Console.Error.WriteLine("usage: whole_job ADDRESS SCAN.h5, as in whole_job http://127.0.0.1:8000 mill.h5");
            return 2;
        }
        address = arguments[0];
        var key = Environment.GetEnvironmentVariable("SAWMILL_KEY");
        if (!string.IsNullOrEmpty(key))
            http.DefaultRequestHeaders.Authorization = new AuthenticationHeaderValue("Bearer", key);
        try
        {
            Run(arguments[1]).GetAwaiter().GetResult();
            return 0;
        }
        catch (RefusedException refused)
        {
            Console.Error.WriteLine(refused.Message);
            return 1;
        }
    }
}
